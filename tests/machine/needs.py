"""Optional libraries and programs of the system that some tests need.

A test declares its need by ``@pytest.mark.needs("xvfb")`` or by a fixture of that name. Without the
program it is skipped. With the environment variable RFPIPE_SYSTEM_LIBRARIES set to ``required`` it
fails instead; set to ``hidden``, all optional programs are hidden, as on a bare machine.
"""

from __future__ import annotations

import os
import shutil
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

__all__ = ["DIST", "HINTS", "hide", "need", "program"]

HINTS = {
    "alp": "pip install ALP4lib",
    "aravis": "apt-get install libaravis-0.8-0",
    "chromium": "apt-get install chromium",
    "llvm": "apt-get install libllvm19",
    "micro_manager": "pip install pymmcore mm-test-adapters",
    "release": "make dist",
    "slurm": "apt-get install slurmctld slurmd slurm-client munge, and be root",
    "torch": ".venv/bin/python -m pip install torch",
    "validators": "make validators",
    "xvfb": "apt-get install xvfb",
}
"""How each is installed."""

DIST = Path(__file__).parents[2] / "dist"
VALIDATORS = Path(__file__).parents[2] / ".venv-validators" / "bin" / "python"

_FILES = {"release": (DIST, "*.whl"), "validators": (VALIDATORS.parent, VALIDATORS.name)}

_PACKAGES = {
    "alp": ("ALP4",),
    "micro_manager": ("pymmcore", "mm_test_adapters"),
    "torch": ("torch",),
}

_PROGRAMS = {
    "chromium": ("chromium", "chromium-browser", "google-chrome"),
    "slurm": ("munged", "slurmctld", "slurmd", "sbatch"),
    "xvfb": ("Xvfb",),
}

_VARIABLE = "RFPIPE_SYSTEM_LIBRARIES"
_MODE = os.environ.get(_VARIABLE, "")
assert _MODE in ("", "required", "hidden"), f"{_VARIABLE} is {_MODE}: required, hidden or unset"


def need(name: str) -> None:
    """Skip a test whose program is missing, or fail it if programs are required."""
    if _MODE != "hidden" and _is_here(name):
        return
    by_root_alone = name == "slurm" and os.geteuid() != 0
    tell = pytest.fail if _MODE == "required" and not by_root_alone else pytest.skip
    tell(f"needs {name}: {HINTS[name]}")


def program(name: str) -> str | None:
    """Return the path of a program, from the first of its names on the search path."""
    return next(filter(None, map(shutil.which, _PROGRAMS[name])), None)


def _is_here(name: str) -> bool:
    if name == "llvm":
        from rfpipe.mitsuba.variant import usable_llvm

        return usable_llvm() is not None
    if name == "aravis":
        from rfpipe.devices.aravis_library import load_aravis
        from rfpipe.errors import CaptureError

        try:
            return bool(load_aravis())
        except CaptureError:
            return False
    if name == "slurm":
        return os.geteuid() == 0 and all(map(shutil.which, _PROGRAMS[name]))
    if name in _FILES:
        folder, pattern = _FILES[name]
        return any(folder.glob(pattern))
    packages = _PACKAGES.get(name)
    return all(map(find_spec, packages)) if packages else program(name) is not None


def hide() -> TemporaryDirectory[str] | None:
    """Hide the optional programs from this process and its children, if requested.

    On PATH, each folder that contains such a program is replaced by a temporary folder of links to
    its other programs. Returns the object that owns these folders: they are removed with it.
    """
    if _MODE != "hidden":
        return None
    os.environ["DRJIT_LIBLLVM_PATH"] = "hidden"
    hidden = {program for names in _PROGRAMS.values() for program in names}
    made = TemporaryDirectory(prefix="rfpipe-hidden-")
    folders = os.environ["PATH"].split(os.pathsep)
    for number, folder in enumerate(folders):
        programs = {path.name: path for path in Path(folder).glob("*")}
        if hidden & set(programs):
            links = Path(made.name) / str(number)
            links.mkdir()
            for name in set(programs) - hidden:
                (links / name).symlink_to(programs[name])
            folders[number] = str(links)
    os.environ["PATH"] = os.pathsep.join(folders)
    return made
