"""Output files of commands: complete or absent on a full disk, in the format of their suffix."""

from __future__ import annotations

import errno
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from tests.results.finished_run import write_run
from tests.rigs.known_matrix import contents, run
from tests.services.full_disk import LARGEST
from tests.unit.test_compare import relit

import rfpipe
from rfpipe.cli import app
from rfpipe.errors import InputError, StoreError
from rfpipe.output import FOLDER, FORMATS, OUTPUTS, mount_point, suffix_of, whole_file
from rfpipe.pictures.images import write_image, write_parts
from rfpipe.transport import save_transport
from rfpipe.transport.dense import DenseTransport

SHAPE = (12, 14)
OFFLINE = {
    "scenes": {"desk": {"kind": "captured", "shape": [4, 5], "channels": 1}},
    "methods": {"symmetric": {}},
    "camera": {"exposures": [0.015625, 0.25]},
    "capture": {"rig": "offline", "all_off_brackets": 2, "all_on_brackets": 2},
    "offline": {"projector_shape": [26, 33]},
}
CITED = ("--license", "CC-BY-4.0", "--creator", "Doe, Jane")

# Arguments of each command before --output.
INPUTS: dict[str, tuple[str, ...]] = {
    "relight": ("relight", "dome.zarr", "--pattern", "white"),
    "export": ("export", "dome.zarr"),
    "export --normals": ("export", "dome.zarr", "--normals"),
    "export --photographs": ("export", "dome.zarr", "--photographs", "2", "1"),
    "export --relight": ("export", "dome.zarr", "--relight"),
    "lights": ("lights", "ball", "--ball", "9,9,9"),
    "movie": ("movie", "dome.zarr", "--seconds", "0.2"),
    "compare": ("compare", "relit"),
    "view": ("view", "dome.zarr"),
    "calibrate": ("calibrate", "rig.yaml"),
    "fit": ("fit", "lights.exr", "--anyway"),
    "patterns": ("patterns", "offline.yaml", "--results", "offline"),
    "publish": ("publish", "run", *CITED),
    "collection pack": ("collection", "pack", "run/results"),
    "collection unpack": ("collection", "unpack", "packed"),
}


def dome() -> DenseTransport:
    """Return a transport of nine lights with known directions and a camera of 12 x 14 pixels."""
    random = np.random.default_rng(1)
    lights = random.normal(size=(9, 3))
    lights[:, 2] = 2 + np.abs(lights[:, 2])
    matrix = 0.1 + random.random((3, np.prod(SHAPE), len(lights)), np.float32)
    rows = [{"level": 0, "patterns": 9}]
    transport = DenseTransport(SHAPE, (1, 9), 3, rows, {"matrix": matrix})
    transport.lights = lights
    return transport


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with all inputs of the commands in `INPUTS`."""
    folder = tmp_path_factory.mktemp("inputs")
    save_transport(dome(), folder / "dome.zarr")
    run("export", folder / "dome.zarr", "-o", folder / "lights.exr")
    for name, column in (("a", 8), ("b", 11)):
        ball = np.zeros((20, 20, 3), np.float32)
        ball[9, column] = 1
        write_image(folder / f"ball/{name}.png", ball)
    (folder / "offline.yaml").write_text(yaml.safe_dump(OFFLINE))
    write_run(folder / "run", "desk")
    run("publish", folder / "run", *CITED)  # writes the citation's file
    run("collection", "pack", folder / "run/results", "-o", folder / "packed")
    rig = Path(__file__).parents[2] / "config/bench.yaml"
    (folder / "rig.yaml").write_text(rig.read_text())
    relit(folder / "relit", "room", "symmetric", [(1, 0.4), (19, 0.1), (80, 0.001)])
    return folder


@pytest.fixture
def run_folder(inputs: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(inputs)
    return inputs


def name_of(command: str, suffix: str, at: str) -> str:
    return f"{at}_{command.replace(' ', '_')}{suffix}"


def on_full_disk(folder: Path, cases: list[tuple[int, list[str]]]) -> list[tuple[int, str]]:
    program = [sys.executable, "-m", "tests.services.full_disk", json.dumps(cases)]
    paths = [str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))}
    done = subprocess.run(
        program,
        capture_output=True,
        text=True,
        check=True,
        cwd=folder,
        env=environment,
        timeout=400,
    )
    return [(status, output) for status, output in json.loads(done.stdout)]


def test_every_command_with_an_output_is_in_the_table() -> None:
    import typer

    commands = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    groups = {f"{name} {inner}": of for name, group in commands.items()
              for inner, of in getattr(group, "commands", {}).items()}  # fmt: skip
    writers = {
        name
        for name, command in {**commands, **groups}.items()
        if any("--output" in option.opts for option in command.params)
    }
    assert writers == {name.partition(" --")[0] for name in OUTPUTS}
    assert INPUTS.keys() == OUTPUTS.keys()
    assert {suffix for of in OUTPUTS.values() for suffix in of} <= {*FORMATS, FOLDER}


@pytest.mark.slow
def test_on_a_full_disk_no_command_succeeds_or_leaves_a_partial_file(run_folder: Path) -> None:
    calls = [
        (command, suffix, [*arguments, "--output"])
        for command, arguments in INPUTS.items()
        for suffix in OUTPUTS[command]
        if command != "calibrate"  # it writes by the functions of stores and reports, tested there
    ]
    complete_calls = [(LARGEST, [*call, name_of(*of, "whole")]) for *of, call in calls]
    for (_, arguments), (status, output) in zip(
        complete_calls, on_full_disk(run_folder, complete_calls), strict=True
    ):
        assert status == 0, (arguments, output)
    complete = [contents(run_folder / name_of(*of, "whole")) for *of, _ in calls]
    before = contents(run_folder)
    for share in (0, 0.5, 0.98):
        cases = [
            (int(share * max(map(len, files.values()))), [*call, name_of(*of, "cut")])
            for (*of, call), files in zip(calls, complete, strict=True)
        ]
        ends = on_full_disk(run_folder, cases)
        for (_, arguments), (status, output), files in zip(cases, ends, complete, strict=True):
            assert (status, "Traceback" in output) == (1, False), (arguments, output)
            assert "rfpipe: " in output
            assert "failed: " in output
            assert "make room" in output or "check the folder" in output, output
            made = run_folder / arguments[-1]
            assert contents(made).items() <= files.items() if made.exists() else True
    remaining = {name for name in contents(run_folder).keys() - before.keys() if "cut_" not in name}
    assert {name for name in remaining if not name.endswith(".lock")} == set()


@pytest.mark.parametrize("command", INPUTS)
@pytest.mark.parametrize("suffix", [".jpg", ".tiff", ".csv", ".PDF", ".png", ".zip", ""])
def test_other_suffixes_are_refused_without_output(
    run_folder: Path, command: str, suffix: str
) -> None:
    if suffix.lower() in OUTPUTS[command]:
        return
    before = contents(run_folder)
    with pytest.raises(InputError, match="expected ") as refused:
        run(*INPUTS[command], "-o", f"s{suffix}")
    for allowed in OUTPUTS[command]:
        assert (allowed or "folder's name") in str(refused.value)
    assert contents(run_folder) == before
    assert not Path(f"s{suffix}").exists()


@pytest.mark.parametrize(
    ("name", "allowed", "suffix"),
    [
        ("a.EXR", (".exr",), ".exr"),
        ("relit", (".exr", FOLDER), FOLDER),
        ("crate-1.0", (".zip", FOLDER), FOLDER),
        ("there.d", (".zip", FOLDER), FOLDER),  # a folder that exists
    ],
)
def test_suffixes(name: str, allowed: tuple[str, ...], suffix: str, tmp_path: Path) -> None:
    (tmp_path / "there.d").mkdir()
    assert suffix_of(tmp_path / name, allowed) == suffix


def test_a_folder_in_place_of_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.png").mkdir()
    with pytest.raises(InputError, match="is a folder; name a file"):
        suffix_of(tmp_path / "a.png", (".png",))


@pytest.mark.parametrize("command", INPUTS)
@pytest.mark.parametrize("place", ["afile", "afile/sub", "/dev/full", "/dev/full/sub"])
def test_a_file_or_device_in_place_of_a_folder_is_refused(
    run_folder: Path, command: str, place: str
) -> None:
    (run_folder / "afile").write_text("mine")
    for suffix in OUTPUTS[command]:
        output = f"{place}/a{suffix}" if suffix else place
        with pytest.raises(InputError, match=r"is a (file|device); name a folder"):
            run(*INPUTS[command], "-o", output)
    assert (run_folder / "afile").read_text() == "mine"


def test_a_file_in_place_of_the_calibration_s_folder_is_refused(run_folder: Path) -> None:
    (run_folder / "afile").write_text("mine")
    (run_folder / "filed.yaml").write_text(
        (run_folder / "rig.yaml")
        .read_text()
        .replace("calibration: calibration", "calibration: afile")
    )
    with pytest.raises(InputError, match="afile: is a file; name a folder"):
        run("calibrate", "filed.yaml")


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="needs /proc, in which nobody writes")
@pytest.mark.parametrize(
    "command", [name for name, allowed in OUTPUTS.items() if FOLDER in allowed]
)
def test_a_path_where_no_folder_can_be_created_is_reported(run_folder: Path, command: str) -> None:
    with pytest.raises(StoreError) as caught:
        run(*INPUTS[command], "-o", "/proc/absent")
    assert str(caught.value.place).startswith(("/proc/absent", "/proc/.absent"))
    assert "/proc is writable" in caught.value.remedy or "permission" in caught.value.remedy


@pytest.mark.parametrize("command", ["calibrate", "collection pack"])
@pytest.mark.parametrize("place", ["other", "other/results"])
def test_a_run_s_folder_is_refused_as_output(
    run_folder: Path, command: str, place: str, tmp_path: Path
) -> None:
    (tmp_path / "other/results/desk/dual/L00").mkdir(parents=True)
    with pytest.raises(InputError, match="is the folder of a run, with results; name another"):
        run(*INPUTS[command], "-o", tmp_path / place)
    assert [path.name for path in (tmp_path / "other").iterdir()] == ["results"]


@pytest.mark.parametrize("is_there", [True, False])
def test_a_link_is_kept_and_its_target_is_written(is_there: bool, tmp_path: Path) -> None:
    target, link = tmp_path / "far/target.png", tmp_path / "link.png"
    target.parent.mkdir()
    if is_there:
        target.write_bytes(b"before")
    link.symlink_to("far/target.png")
    write_image(link, RADIANCE)
    assert link.is_symlink()
    assert target.read_bytes().startswith(b"\x89PNG")
    assert {path.name for path in target.parent.iterdir()} == {"target.png"}


def cut(path: Path, write: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Write a file whose last bytes are lost without an error, like libraries on a full disk."""
    import os

    fsync = os.fsync

    def losing(descriptor: int) -> None:
        fsync(descriptor)
        for partial in path.parent.glob(".partial-*"):
            os.truncate(partial, partial.stat().st_size // 2)

    monkeypatch.setattr(os, "fsync", losing)
    write(path)


RADIANCE = np.random.default_rng(0).random((40, 50, 3), np.float32)
WRITERS: dict[str, Callable[[Path], object]] = {
    "picture.png": lambda path: write_image(path, RADIANCE),
    "picture.exr": lambda path: write_image(path, RADIANCE),
    "parts.exr": lambda path: write_parts(path, ["a", "b"], RADIANCE.shape, [RADIANCE, RADIANCE]),
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_silently_truncated_file_is_detected(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    WRITERS[name](tmp_path / name)
    before = (tmp_path / name).read_bytes()
    with pytest.raises(StoreError, match="writing failed") as caught:
        cut(tmp_path / name, WRITERS[name], monkeypatch)
    assert caught.value.place == tmp_path / name
    assert contents(tmp_path) == {name: before}


RESUMED = ("patterns", "calibrate", "collection pack", "collection unpack")


@pytest.mark.parametrize("command", [name for name in INPUTS if name not in RESUMED])
def test_a_full_disk_promises_no_resumption_to_commands_that_start_over(
    run_folder: Path, command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import os

    def full(self: Path, target: Path) -> Path:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "replace", full)
    monkeypatch.setattr(Path, "rename", full)
    for suffix in OUTPUTS[command]:
        with pytest.raises(StoreError, match="make room and run again") as caught:
            run(*INPUTS[command], "-o", tmp_path / f"made{suffix}")
        assert "continues" not in str(caught.value)


def test_errors_name_the_disk(tmp_path: Path) -> None:
    place = mount_point(tmp_path / "new/a.bin")
    assert place.is_mount()
    error = OSError(28, "No space left on device")
    with (
        pytest.raises(
            StoreError, match=rf"writing failed: No space.*disk at {place}; make"
        ) as caught,
        whole_file(tmp_path / "a.bin", 10),
    ):
        raise error
    assert caught.value.place == tmp_path / "a.bin"


def test_standard_output_on_a_full_disk_is_an_error_without_a_traceback(run_folder: Path) -> None:
    program = [sys.executable, "-c", "from rfpipe.cli import main; main()", "info", "dome.zarr"]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            program, stdout=full, stderr=subprocess.PIPE, text=True, check=False, cwd=run_folder
        )
    assert done.returncode == 1
    assert done.stderr.startswith("rfpipe: a file can't be written: [Errno 28] No space left")
    assert len(done.stderr.splitlines()) == 1


# Modules that write files directly: the writer of outputs, stores with their own digests, whose
# folders are renamed when they are complete, and publications.
WRITERS_OF_FILES = {"output.py", "items.py", "journal.py", "lock.py", "writing.py"}
_WRITES = re.compile(
    r"""\.write_(?:text|bytes)\(|np\.save|\.to_csv\((?!index=)|open\([^)]*["'][wax]b?\+?["']|savetxt\("""
    r"""|\.savefig\((?!\w*buffer|image)|imsave\((?!buffer)"""
)


def test_no_further_module_writes_files_directly() -> None:
    """All other modules write through `whole_file`."""
    source = Path(rfpipe.__file__).parents[1]
    places = {
        f"{path.relative_to(source).as_posix()}: {line.strip()}"
        for path in source.rglob("*.py")
        if path.name not in WRITERS_OF_FILES and path.parent.name != "kernel"
        for line in path.read_text(encoding="utf-8").splitlines()
        if _WRITES.search(line)
    }
    known = {
        # write to the temporary file of `whole_file`
        "rfpipe/cli/relight.py": "partial_file.open",
        "rfpipe/export/movies.py": "av.open",
        "rfpipe/transport/matrix_export.py": "archive.open|path.open|zipfile.ZipFile",
        # appends a line to a log
        "rfpipe/storage/files.py": "log.open",
        # messages in memory
        "rfpipe/rigs/messages.py": "archive.open",
    }
    for place in sorted(places):
        name, _, line = place.partition(": ")
        assert name in known, place
        assert re.search(known[name], line), place
