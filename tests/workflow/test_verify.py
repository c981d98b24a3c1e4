"""Damaged runs: what is wrong is found, mended by the command named, and the bytes are equal."""

from __future__ import annotations

import logging
import shutil
import subprocess
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.workflow.harness import TINY, Workflow
from tests.workflow.stagewise import CAMERA, FaultyRig, damage, left, matrix_rig
from tests.workflow.stagewise import acquire as acquire_matrix

from rfpipe.calibration.folder import CalibrationFolder, MadeFor
from rfpipe.calibration.verdicts import Findings, Verdict
from rfpipe.errors import IntegrityError
from rfpipe.stages.checking import check, command_for


def acquire(path: Path, method: str = "symmetric") -> list[tuple[int, ...]]:
    """Do what the workflow's job does; return the keys of the patterns shown."""
    rig = FaultyRig(matrix_rig(noise=CAMERA), lambda key, frame: frame)
    acquire_matrix(path, rig, method)
    return rig.shown


@pytest.fixture(scope="module")
def intact(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of a matrix by symmetric and by dual photography; leave them as they are."""
    results = tmp_path_factory.mktemp("intact") / "results"
    for method in ("symmetric", "dual"):
        acquire(results / "matrix" / method, method)
    return results


@pytest.fixture
def results(intact: Path, tmp_path: Path) -> Path:
    shutil.copytree(intact, tmp_path / "results")
    return tmp_path / "results"


def flip(path: Path, old: str, new: str) -> None:
    content = path.read_text()
    assert old in content
    path.write_text(content.replace(old, new, 1))


def other_digit(path: Path, after: str) -> None:
    """Change the first digit after a text."""
    content = path.read_text()
    at = next(i for i in range(content.index(after), len(content)) if content[i].isdigit())
    path.write_text(content[:at] + str((int(content[at]) + 1) % 10) + content[at + 1 :])


def misplace(run: Path, name: str) -> None:
    """Lay dual photography's into symmetric photography's folder."""
    other = run.parent / "dual" / name
    shutil.rmtree(run / name, ignore_errors=True)
    (shutil.copytree if other.is_dir() else shutil.copy)(other, run / name)


def a_line_less(run: Path) -> None:
    journal = run / "L01/capture.zarr/journal.jsonl"
    lines = journal.read_text().splitlines(keepends=True)
    journal.write_text("".join(lines[:2] + lines[3:]))


DAMAGES: dict[str, Callable[[Path], object]] = {
    "capture: chunk truncated": lambda run: damage(run / "L01/capture.zarr"),
    "capture: chunk missing": lambda run: (run / "L03/capture.zarr/c.1.0.0.0.0").unlink(),
    "capture: header missing": lambda run: (run / "L02/capture.zarr/zarr.json").unlink(),
    "capture: a digit of the header": lambda run: other_digit(
        run / "L02/capture.zarr/zarr.json", "fingerprint"
    ),
    "capture: line of the journal lost": a_line_less,
    "reference: chunk truncated": lambda run: damage(run / "L00/reference.zarr"),
    "schedule: store missing": lambda run: shutil.rmtree(run / "L02/schedule.zarr"),
    "merge: chunk truncated": lambda run: damage(run / "L01/merge.zarr"),
    "sums: chunk truncated": lambda run: damage(run / "L02/sums.zarr"),
    "floodlit image: chunk truncated": lambda run: damage(run / "L00/merged_reference.zarr"),
    "normalize: manifest missing": lambda run: (run / "L02/normalize.json").unlink(),
    "normalize: attributes altered": lambda run: flip(
        run / "L02/normalize.zarr/zarr.json", "per_channel", "per_chanmel"
    ),
    "refine: manifest altered": lambda run: flip(run / "L01/refine.json", "symmetric", "symmetrik"),
    "refine: store of another run": lambda run: misplace(run, "L01/refine.zarr"),
    "level: missing": lambda run: shutil.rmtree(run / "L03"),
    "transport: chunk truncated": lambda run: damage(run / "transport.zarr"),
    "transport: of another method": lambda run: misplace(run, "transport.zarr"),
    "transport: of another method, with its manifest": lambda run: [
        misplace(run, name) for name in ("transport.zarr", "transport.json")
    ],
}


def test_an_intact_run_is_found_whole(intact: Path) -> None:
    checked = check(intact)
    assert checked.findings == []
    assert checked.notes == []
    assert checked.stores == 2 * (4 * 6 + 2 + 1)
    assert checked.manifests == 2 * (4 * 5 + 1)


@pytest.mark.parametrize("kind", DAMAGES)
def test_damage_is_found_and_mended_to_the_same_bytes(
    intact: Path, results: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = results / "matrix" / "symmetric"
    DAMAGES[kind](run)
    findings = check(results).findings
    assert findings
    assert all(finding.path.is_relative_to(run) for finding in findings)
    for finding in findings:
        remove, _, again = command_for(finding).partition(" && ")
        assert Path(again.split()[0]).name == "rfpipe"
        assert str(run / "transport.json") in remove
        subprocess.run(remove, shell=True, check=True)
    shown = acquire(run)
    of_captures = kind.startswith(("capture: chunk", "capture: line", "reference", "level"))
    assert bool(shown) == of_captures
    if kind.startswith("capture"):
        assert len(shown) <= 1  # the damaged pattern alone
    assert check(results).findings == []
    assert left(results) == left(intact)


@pytest.mark.parametrize("kind", [kind for kind in DAMAGES if "transport" not in kind])
def test_a_run_heals_what_it_finds_damaged_and_shows_no_pattern(
    intact: Path, results: Path, kind: str, caplog: pytest.LogCaptureFixture
) -> None:
    run = results / "matrix" / "symmetric"
    # a run that stopped before its transport, and whose last level is to be refined
    for name in ("transport.json", "L03/merge.json", "L03/normalize.json", "L03/refine.json"):
        (run / name).unlink()
    shutil.rmtree(run / "L03/merge.zarr")
    shutil.rmtree(run / "L03/refine.zarr")
    DAMAGES[kind](run)
    with caplog.at_level(logging.WARNING, logger="rfpipe"):
        if kind == "capture: chunk missing":
            with pytest.raises(IntegrityError, match=r"remove .*capture\.json and run again"):
                acquire(run)
            return
        shown = acquire(run)
    assert bool(shown) == (kind == "level: missing")
    assert "CAPTURING ANEW" not in caplog.text


def test_a_calibration_is_checked_and_measured_again(tmp_path: Path) -> None:
    folder = CalibrationFolder(tmp_path / "calibration")
    measured = MadeFor({"sensor.bits": 12}, {}, {})
    folder.write("dark", Findings(Verdict("good", ""), {"a": 1}, {"black": np.ones(4)}), measured)
    folder.write("light", Findings(Verdict("good", ""), {"a": 1}, {"light": np.ones(9)}), measured)
    assert check(folder.path).findings == []
    shutil.rmtree(folder.store("dark"))
    shutil.copytree(folder.store("light"), folder.store("dark"))
    (finding,) = check(folder.path).findings
    assert "isn't the store of dark.json" in finding.what
    command = command_for(finding)
    assert command.startswith(f"rm -rf {folder.manifest('dark')} && rfpipe calibrate RIG.yaml")
    assert command.endswith(str(folder.path))


def test_a_running_acquisition_is_left_alone(results: Path) -> None:
    from rfpipe.store import StoreLock

    with StoreLock(results / "matrix" / "symmetric"):
        checked = check(results)
    assert [note for note in checked.notes if "at this moment" in note]
    assert checked.stores == 27


def test_dropped_exposures_are_no_damage_and_what_is_made_of_them_is_dear(results: Path) -> None:
    from rfpipe.store import drop

    run = results / "matrix" / "symmetric"
    for level in range(4):
        drop(run / f"L{level:02d}" / "capture.zarr")
    assert check(results).findings == []
    damage(run / "L01/merge.zarr")
    (finding,) = check(results).findings
    assert "ALL patterns" in finding.mend.cost
    assert run / "L03" in finding.mend.remove
    subprocess.run(command_for(finding).partition(" && ")[0], shell=True, check=True)
    assert acquire(run)
    assert check(results).findings == []


def test_a_published_folder_is_checked_by_its_list(intact: Path, tmp_path: Path) -> None:
    import hashlib

    crate = tmp_path / "crate"
    shutil.copytree(intact / "matrix/dual/transport.zarr", crate / "data" / "transport.zarr")
    files = sorted(path for path in crate.rglob("*") if path.is_file())
    lines = [
        f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.relative_to(crate).as_posix()}"
        for path in files
    ]
    (crate / "manifest-sha256.txt").write_text("\n".join(lines) + "\n")
    checked = check(crate)
    assert (checked.findings, checked.files) == ([], len(files))
    archive = Path(shutil.make_archive(str(tmp_path / "crate"), "zip", tmp_path, "crate"))
    checked = check(archive)
    assert (checked.findings, checked.files) == ([], len(files))
    content = bytearray(archive.read_bytes())
    with zipfile.ZipFile(archive) as held:
        largest = max(held.infolist(), key=lambda info: info.compress_size)
    content[largest.header_offset + 30 + len(largest.filename) + largest.compress_size // 2] ^= 1
    archive.write_bytes(content)
    (finding,) = check(archive).findings
    assert str(finding.path).endswith(Path(largest.filename).name)
    files[0].write_bytes(b"something else")
    files[1].unlink()
    (crate / "more.txt").write_text("?")
    checked = check(crate)
    found = {finding.path: finding.what for finding in checked.findings}
    assert set(found) == set(files[:2])
    assert found[files[1]] == "is missing"
    assert checked.notes == [f"{crate / 'more.txt'}: isn't in the list of files"]


def test_a_store_without_a_run_can_be_checked_too(intact: Path, tmp_path: Path) -> None:
    store = tmp_path / "mine.zarr"
    shutil.copytree(intact / "matrix/dual/transport.zarr", store)
    assert check(store).findings == []
    damage(store)
    (finding,) = check(store).findings
    assert command_for(finding) == ""


@pytest.mark.slow
def test_a_run_damaged_in_many_ways_at_once_is_mended_by_the_commands_named(
    copy: Workflow, undisturbed: Workflow
) -> None:
    run = copy.path("tiny/symmetric")
    (run / "L02/capture.zarr/zarr.json").unlink()
    (run / "L01/normalize.json").unlink()
    other_digit(run / "L00/schedule.json", "patterns")
    for store in ("L03/capture.zarr", "L02/merge.zarr", "L01/refine.zarr"):
        damage(run / store)
    misplace(run, "transport.zarr")
    findings = check(copy.folder).findings
    harmed = {Path(finding.path).relative_to(run).as_posix() for finding in findings}
    assert harmed == {
        "L02/capture.zarr", "L01/normalize.json", "L00/schedule.json", "L03/capture.zarr",
        "L02/merge.zarr", "L01/refine.zarr", "transport.zarr",
    }  # fmt: skip
    commands = [command_for(finding).partition(" && ") for finding in findings]
    for removal, _, _ in commands:
        subprocess.run(removal, shell=True, check=True)
    (again,) = {again for _, _, again in commands}
    again = again.replace(" run ", f" run {TINY} ", 1)  # and not the whole report
    subprocess.run(again, shell=True, check=True, capture_output=True)
    assert copy.contents("tiny/symmetric") == undisturbed.contents("tiny/symmetric")
    assert check(run).findings == []
