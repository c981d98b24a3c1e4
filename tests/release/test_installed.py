"""The wheel in new environments without the clone, on each Python of this machine."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path

import pytest
from tests.machine.pythons import installed_pythons

from rfpipe.installation import DISTRIBUTION
from rfpipe.store import read_manifest

ROOT = Path(__file__).parents[2]
UV = (sys.executable, "-m", "uv")
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"][
    "optional-dependencies"
]

SETTINGS = """\
scenes: {tiny: {kind: wedge, shape: [8, 8]}}
methods: {near_far: {}}
seed: 1
"""

STEPS = {
    "--version": "rfpipe 0.1.0",
    "plan mine.yaml": "mine.yaml: valid. 1 acquisition",
    "run --configfile mine.yaml": "report: results/report/index.html",
    "view results/tiny/near_far -o page.html": "page.html: ",
    "verify": "results: undamaged",
}
"""Outputs of commands, one after the other."""

CALLS = """\
import sys
from importlib import import_module
import rfpipe
from rfpipe.config import parse_rig_config
from rfpipe.errors import RfpipeError
from rfpipe.rigs import RemoteRig
from rfpipe.rigs.calibrated import sensor_of

def projector(driver):
    parse_rig_config({"projector": {"driver": driver}}, "").projector.make(response=None)

def camera(driver, *options):
    camera = {"driver": driver, "options": dict(it.split("=") for it in options)}
    rig = parse_rig_config({"camera": camera, "sensor": {"bits": 8}}, "")
    rig.camera.make(sensor=sensor_of(rig))

def remote():
    RemoteRig("http://127.0.0.1:1", "0123456789abcdef")

def matrix():
    rfpipe.read_matrix("t.h5")

def xarray():
    rfpipe.open_transport("results/tiny/near_far").to_xarray()

def module(name):
    import_module(name)

name, *arguments = sys.argv[1:]
try:
    globals()[name](*arguments)
except RfpipeError as error:
    sys.exit(str(error))
"""

FILES = {
    "calls.py": CALLS,
    "mine.yaml": SETTINGS,
    "mitsuba.yaml": SETTINGS.replace("kind: wedge", "kind: mitsuba, scene: red_wall_box"),
    "rig.yaml": "camera: {driver: webcam}\n",
    "slurm/config.yaml": "executor: slurm\n",
    "t.h5": "",
}

MISSING = {
    "rig": (
        "rfpipe aim rig.yaml",
        "rfpipe serve rig.yaml",
        "rfpipe calibrate rig.yaml",
        "python calls.py remote",
        "python calls.py projector window",
        "python calls.py camera pylon",
    ),
    "gphoto2": ("python calls.py camera gphoto2",),
    "webcam": ("python calls.py camera webcam",),
    "dlp": ("python calls.py projector dlpc900",),
    "alp": ("python calls.py projector alp",),
    "micromanager": (
        "python calls.py camera micro_manager adapters=. library=DemoCamera device=DCam",
    ),
    "mitsuba": ("rfpipe plan mitsuba.yaml", "python calls.py module rfpipe.interop.drjit"),
    "export": (
        "rfpipe export results/tiny/near_far -o t.mat",
        "rfpipe movie results/tiny/near_far -o t.mp4",
    ),
    "pictures": ("python calls.py matrix",),
    "cluster": (
        "rfpipe run --configfile mine.yaml --executor cluster-generic",
        "rfpipe run --configfile mine.yaml --profile slurm",
    ),
    "publish": ("rfpipe info s3://bucket/key", "rfpipe verify https://example.org/crate.zip"),
    "xarray": ("python calls.py xarray",),
    "torch": ("python calls.py module rfpipe.interop.torch",),
    "jax": ("python calls.py module rfpipe.interop.jax",),
}
"""Commands that fail without an extra."""


def test_each_extra_with_packages_is_in_the_table() -> None:
    unused = {"dev", "docs"}  # of the clone: no code of rfpipe imports their packages
    assert set(MISSING) == {name for name, packages in EXTRAS.items() if packages} - unused


@dataclass(frozen=True)
class Installed:
    """An environment with rfpipe, and an empty folder to work in.

    Attributes
    ----------
    folder : Path
        Working folder.
    programs : Path
        Folder of ``python`` and ``rfpipe``.
    """

    folder: Path
    programs: Path

    @classmethod
    def make(cls, folder: Path, python: Path, wheel: Path) -> Installed:
        """Install the wheel with the packages of requirements.lock."""
        (folder / "work").mkdir()
        made = cls(folder / "work", folder / "venv" / "bin")
        subprocess.run([*UV, "venv", "--quiet", "--python", python, folder / "venv"], check=True)
        made.install("--constraint", constraints(folder), wheel)
        for name, content in FILES.items():
            (made.folder / name).parent.mkdir(exist_ok=True)
            (made.folder / name).write_text(content, "utf-8")
        return made

    def install(self, *packages: object) -> None:
        """Install packages from the package index."""
        pip = [*UV, "pip", "install", "--quiet", "--python", self.programs / "python"]
        subprocess.run([*pip, *map(str, packages)], check=True, cwd=self.folder)

    def run(self, command: str, status: int = 0) -> str:
        """Run a command, and return its output."""
        program, *arguments = command.split()
        ended = subprocess.run(
            [self.programs / program, *arguments], cwd=self.folder, env=environment(), text=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False, timeout=1200,
        )  # fmt: skip
        assert ended.returncode == status, f"{command}\n{ended.stdout}"
        return ended.stdout


def environment() -> dict[str, str]:
    """Return environment variables that name nothing of the clone or its environment."""
    ours = ("PYTHON", "VIRTUAL_ENV", "RFPIPE_")
    variables = {name: it for name, it in os.environ.items() if not name.startswith(ours)}
    return {**variables, "RFPIPE_TOKEN": "0123456789abcdef", "UV_PYTHON_DOWNLOADS": "never"}


def constraints(folder: Path) -> Path:
    """Write the versions of requirements.lock without hashes, which pip would want of the wheel."""
    locked = (ROOT / "requirements.lock").read_text("utf-8")
    path = folder / "constraints.txt"
    path.write_text("\n".join(re.findall(r"^(\S+==[^\\\n]+?) *\\?$", locked, re.M)), "utf-8")
    return path


@pytest.mark.slow
@pytest.mark.parametrize("python", installed_pythons())
def test_the_wheel_works_without_the_clone(python: str, release: Path, scratch: Path) -> None:
    installed = Installed.make(scratch, installed_pythons()[python], release)
    for arguments, expected in STEPS.items():
        assert expected in installed.run(f"rfpipe {arguments}")
    record = read_manifest(installed.folder / "results" / "run.json")
    assert any("rfpipe/_workflow/Snakefile" in option for option in record["options"])
    for extra, commands in MISSING.items():
        remedy = f'run pip install "{DISTRIBUTION}[{extra}]"'
        for command in commands:
            message = installed.run(command, status=1)
            assert remedy in message, f"{command}\n{message}"
            assert "Traceback" not in message, f"{command}\n{message}"
    installed.install("--constraint", constraints(scratch), f"{DISTRIBUTION}[export]")
    installed.run("rfpipe export results/tiny/near_far -o t.mat")


@pytest.mark.slow
@pytest.mark.parametrize("runner", ["uvx --from", "uvx pipx run --spec"])
def test_the_wheel_runs_without_an_installation(runner: str, release: Path, scratch: Path) -> None:
    command = [*runner.split(), release, "rfpipe", "plan", "mine.yaml"]
    locked = {"UV_CONSTRAINT": constraints(scratch), "PIP_CONSTRAINT": constraints(scratch)}
    folders = {"PIPX_HOME": scratch / "pipx", "UV_TOOL_DIR": scratch / "tools"}
    paths = {"UV_PYTHON": Path(sys.executable), **locked, **folders}
    variables = {name: str(path) for name, path in paths.items()} | {"PIP_NO_COMPILE": "1"}
    (scratch / "mine.yaml").write_text(SETTINGS, "utf-8")
    ended = subprocess.run(
        [Path(sys.executable).with_name(command[0]), *command[1:]], cwd=scratch, text=True,
        env=environment() | variables, capture_output=True, check=False,
    )  # fmt: skip
    assert "mine.yaml: valid. 1 acquisition" in ended.stdout, ended.stderr
