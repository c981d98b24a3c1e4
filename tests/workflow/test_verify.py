"""Checks of damaged runs, and repairs to the same bytes by the given commands."""

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
from tests.workflow.stagewise import CAMERA, FaultyRig, damage, matrix_rig, stored
from tests.workflow.stagewise import acquire as acquire_matrix

from rfpipe.calibration.folder import CalibrationFolder, StepConditions
from rfpipe.calibration.verdicts import Findings, Verdict
from rfpipe.errors import IntegrityError
from rfpipe.storage.base import STAGES
from rfpipe.storage.checking import check
from rfpipe.storage.repairs import command_for
from rfpipe.store import read_manifest, write_arrays, write_manifest


def acquire(path: Path, method: str = "symmetric") -> list[tuple[int, ...]]:
    """Acquire like the workflow's job; return the keys of all patterns shown."""
    rig = FaultyRig(matrix_rig(noise=CAMERA), lambda key, frame: frame)
    acquire_matrix(path, rig, method)
    return rig.shown


@pytest.fixture(scope="module")
def intact(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of a matrix by symmetric and by dual photography; read only."""
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
    """Change the first digit after a text in a file."""
    content = path.read_text()
    at = next(i for i in range(content.index(after), len(content)) if content[i].isdigit())
    path.write_text(content[:at] + str((int(content[at]) + 1) % 10) + content[at + 1 :])


def misplace(run: Path, name: str) -> None:
    """Replace a file of symmetric photography by the one of dual photography."""
    source = run.parent / "dual" / name
    shutil.rmtree(run / name, ignore_errors=True)
    (shutil.copytree if source.is_dir() else shutil.copy)(source, run / name)


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
    "reference: chunk truncated": lambda run: damage(run / "L00/reference_brackets.zarr"),
    "schedule: store missing": lambda run: shutil.rmtree(run / "L02/schedule.zarr"),
    "merge: chunk truncated": lambda run: damage(run / "L01/merge.zarr"),
    "sums: chunk truncated": lambda run: damage(run / "L02/sums.zarr"),
    "floodlit image: chunk truncated": lambda run: damage(run / "L00/reference_images.zarr"),
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


def test_an_intact_run_has_no_findings(intact: Path) -> None:
    checked = check(intact)
    assert checked.findings == []
    assert checked.notes == []
    assert checked.stores == 2 * (4 * 6 + 2 + 1 + 1)  # the last schedule has no patterns
    assert checked.manifests == 2 * (4 * 5 + 1 + 1)


@pytest.mark.parametrize("kind", DAMAGES)
def test_damage_is_found_and_repaired_to_the_same_bytes(
    intact: Path, results: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = results / "matrix" / "symmetric"
    DAMAGES[kind](run)
    findings = check(results).findings
    assert findings
    assert all(finding.path.is_relative_to(run) for finding in findings)
    for finding in findings:
        remove, _, command = command_for(finding).partition(" && ")
        assert Path(command.split()[0]).name == "rfpipe"
        assert str(run / "transport.json") in remove
        subprocess.run(remove, shell=True, check=True)
    shown = acquire(run)
    of_captures = kind.startswith(("capture: chunk", "capture: line", "reference", "level"))
    assert bool(shown) == of_captures
    if kind.startswith("capture"):
        assert len(shown) <= 1  # only the damaged pattern
    assert check(results).findings == []
    assert stored(results) == stored(intact)


# Names of folders of runs, calibrations, recordings and clones; scenes and methods may have them.
FOLDERS = (
    "bench", "report", "recorded", "logs", "cache", "view", "catalogue", "figures", "tables",
    "results", "calibration", "steps", "dark", "verification", "provenance", "source", "objects",
    "venv", "transport", "capture", "matrix", "relit", "pictures", "patterns", "l00", "keep",
)  # fmt: skip


NAMES = [
    name if name in ("bench", "recorded") else pytest.param(name, marks=pytest.mark.slow)
    for name in FOLDERS
]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("of", ["scene", "method", "both", "folder above"])
def test_what_is_read_follows_from_manifests_whatever_a_folder_is_called(
    intact: Path, tmp_path: Path, name: str, of: str
) -> None:
    above = tmp_path / name if of == "folder above" else tmp_path
    scene = name if of in ("scene", "both") else "matrix"
    run = above / "results" / scene / (name if of in ("method", "both") else "symmetric")
    shutil.copytree(intact / "matrix/symmetric", run)
    checked = check(above / "results")
    assert (checked.findings, checked.notes) == ([], [])
    # four levels, reference brackets and images, the transport, and a schedule without patterns
    assert (checked.stores, checked.manifests) == (4 * 6 + 2 + 1 + 1, 4 * 5 + 1 + 1)
    damage(run / "L01/capture.zarr")
    shutil.rmtree(run / "transport.zarr")
    for place in (above, above / "results", run.parent, run):
        findings = {finding.path: finding for finding in check(place).findings}
        assert set(findings) == {run / "L01/capture.zarr", run / "transport.zarr"}
        levels = [run / f"L01/{stage}.json" for stage in STAGES[1:]]
        assert findings[run / "L01/capture.zarr"].repair.remove == (*levels, run / "transport.json")
        assert findings[run / "transport.zarr"].repair.remove == (run / "transport.json",)
        for finding in findings.values():
            assert f"run --directory {above.resolve()} " in command_for(finding)


def test_files_without_a_manifest_are_reported(results: Path) -> None:
    run = results / "matrix/symmetric"
    (run / "L00/notes.txt").write_text("mine")
    (run / "capture.log").write_text("a log")
    (run / "transport.zarr/forgotten").mkdir()
    checked = check(results)
    assert checked.findings == []
    assert checked.notes == [
        f"{run / 'L00'}: 1 file that no manifest names is not checked: notes.txt",
        f"{run / 'transport.zarr'}: 1 file that no manifest names is not checked: forgotten",
    ]
    assert checked.unnamed == [run / "L00/notes.txt", run / "transport.zarr/forgotten"]


def test_a_missing_transport_is_found_by_the_results_computed_from_it(results: Path) -> None:
    run = results / "matrix/symmetric"
    made = {"stage": "relight", "transport": read_manifest(run / "transport.json")["digest"]}
    write_manifest(run / "relight.json", made)
    assert check(results).findings == []
    shutil.rmtree(run / "transport.zarr")
    (run / "transport.json").unlink()
    (finding,) = check(results).findings
    assert finding.path == run / "transport.json"
    assert finding.what == "is missing, and relight.json is made of it"
    acquire(run)
    assert check(results).findings == []


def test_links_to_other_disks_are_followed_and_broken_ones_found(
    results: Path, tmp_path: Path
) -> None:
    (results / "matrix/dual").rename(tmp_path / "other disk")
    link = results / "matrix/dual"
    link.symlink_to(tmp_path / "other disk")
    (tmp_path / "other disk" / "again").symlink_to(link)  # a circular link
    assert check(results).stores == 2 * (4 * 6 + 2 + 1 + 1)  # the last schedule has no patterns
    damage(tmp_path / "other disk/L01/merge.zarr")
    (finding,) = check(results).findings
    assert finding.path == link / "L01/merge.zarr"
    shutil.rmtree(tmp_path / "other disk")
    (finding,) = check(results).findings
    assert finding.path == link
    assert "which is missing" in finding.what


PIECES = ("rows_00000000", "rows_00000040")


@pytest.mark.parametrize(
    ("harm", "harmed"),
    [
        (lambda folder: damage(folder / "rows_00000040.zarr"), "rows_00000040.zarr"),
        (lambda folder: shutil.rmtree(folder / "rows_00000040.zarr"), "rows_00000040.zarr"),
        (lambda folder: flip(folder / "matrix.json", "pieces", "places"), "matrix.json"),
    ],
)
def test_recorded_light_is_checked_by_its_manifest(
    tmp_path: Path, harm: Callable[[Path], object], harmed: str
) -> None:
    folder = tmp_path / "results/light/box-0123456789ab"
    for piece in PIECES:
        write_arrays(folder / f"{piece}.zarr", {"values": np.arange(9000.0)}, {})
    pieces = [["rows", int(name[-8:]), 40] for name in PIECES]
    write_manifest(folder / "matrix.json", {"pieces": pieces})
    checked = check(tmp_path)
    assert (checked.findings, checked.stores, checked.manifests) == ([], 2, 1)
    harm(folder)
    (finding,) = check(tmp_path).findings
    assert finding.path == folder / harmed
    assert "recorded again" in finding.repair.cost
    assert set(finding.repair.remove) == {folder / "matrix.json", folder / harmed}


def test_a_finding_has_one_remedy(results: Path) -> None:
    run = results / "matrix/symmetric"
    damage(run / "transport.zarr")
    flip(run / "L01/refine.json", "symmetric", "symmetrik")
    shutil.rmtree(run / "L02/schedule.zarr")
    flip(run / "L02/normalize.zarr/zarr.json", "per_channel", "per_chanmel")
    (run / "L00/merge.zarr/zarr.json").write_text("{")
    findings = check(results).findings
    assert len(findings) == 5
    for finding in findings:
        assert "emove" not in finding.what
        assert "run" not in finding.what.replace("truncated", "")
        assert not finding.what.endswith((".", ";"))


@pytest.mark.parametrize("kind", [kind for kind in DAMAGES if "transport" not in kind])
def test_a_run_repairs_damaged_stages_without_new_pictures(
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
    assert "CAPTURING AGAIN" not in caplog.text


def test_a_calibration_is_checked_and_measured_again(tmp_path: Path) -> None:
    folder = CalibrationFolder(tmp_path / "calibration")
    measured = StepConditions({"sensor.bits": 12}, {}, {})
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


def test_a_running_acquisition_is_not_checked(results: Path) -> None:
    from rfpipe.store import StoreLock

    with StoreLock(results / "matrix" / "symmetric"):
        checked = check(results)
    assert [note for note in checked.notes if "at this moment" in note]
    assert checked.stores == 4 * 6 + 2 + 1 + 1  # of the other acquisition


def test_deleted_exposures_are_no_damage_but_make_merged_images_irreplaceable(
    results: Path,
) -> None:
    from rfpipe.store import drop

    run = results / "matrix" / "symmetric"
    for level in range(4):
        drop(run / f"L{level:02d}" / "capture.zarr")
    assert check(results).findings == []
    damage(run / "L01/merge.zarr")
    (finding,) = check(results).findings
    assert "ALL patterns" in finding.repair.cost
    assert run / "L03" in finding.repair.remove
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
    with zipfile.ZipFile(archive) as zip_file:
        largest = max(zip_file.infolist(), key=lambda info: info.compress_size)
    content[largest.header_offset + 30 + len(largest.filename) + largest.compress_size // 2] ^= 1
    archive.write_bytes(content)
    (finding,) = check(archive).findings
    assert str(finding.path).endswith(Path(largest.filename).name)
    files[0].write_bytes(b"something else")
    files[1].unlink()
    (crate / "more.txt").write_text("?")
    checked = check(crate)
    findings = {finding.path: finding.what for finding in checked.findings}
    assert set(findings) == set(files[:2])
    assert findings[files[1]] == "is missing"
    assert checked.notes == [f"{crate / 'more.txt'}: isn't in the list of files"]


def test_a_store_outside_a_run_can_be_checked(intact: Path, tmp_path: Path) -> None:
    store = tmp_path / "mine.zarr"
    shutil.copytree(intact / "matrix/dual/transport.zarr", store)
    assert check(store).findings == []
    damage(store)
    (finding,) = check(store).findings
    assert command_for(finding) == ""


@pytest.mark.slow
def test_a_run_with_several_kinds_of_damage_is_repaired_by_the_given_commands(
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
    (command,) = {command for _, _, command in commands}
    command = command.replace(" run ", f" run {TINY} ", 1)  # without the report
    subprocess.run(command, shell=True, check=True, capture_output=True)
    assert copy.contents("tiny/symmetric") == undisturbed.contents("tiny/symmetric")
    assert check(run).findings == []
