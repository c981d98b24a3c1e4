"""Caches of libraries if the home folder isn't writable."""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

import rfpipe
from rfpipe.caches import ensure_cache_folders

VARIABLES = ("XDG_CACHE_HOME", "XDG_CONFIG_HOME", "MPLCONFIGDIR")


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A home folder, with temporary files next to it and no variables for other folders."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    for name in VARIABLES:
        monkeypatch.setenv(name, "")
        monkeypatch.delenv(name)
    home = tmp_path / "home"
    home.mkdir()
    monkeypatch.setenv("HOME", str(home))
    return home


def test_nothing_changes_for_a_writable_home(home: Path) -> None:
    ensure_cache_folders()
    assert not any(name in os.environ for name in VARIABLES)
    assert not list(home.iterdir())


@pytest.mark.parametrize("below", [".", "a/b"])
def test_an_unwritable_home_gets_other_cache_folders(home: Path, below: str, monkeypatch) -> None:
    home.rmdir()
    home.write_text("a file, below which even root makes no folder")
    monkeypatch.setenv("HOME", str(home / below))
    ensure_cache_folders()
    folder = home.with_name(f"rfpipe-cache-{os.getuid()}")
    assert os.environ["XDG_CACHE_HOME"] == str(folder)
    assert os.environ["MPLCONFIGDIR"] == str(folder / "matplotlib")
    assert "XDG_CONFIG_HOME" not in os.environ  # profiles are read from there
    assert folder.stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize("kind", ["open to others", "link"])
def test_a_cache_that_others_can_write_is_not_used(home: Path, kind: str, monkeypatch) -> None:
    monkeypatch.setenv("HOME", "/dev/null/home")
    folder = home.with_name(f"rfpipe-cache-{os.getuid()}")
    if kind == "link":
        folder.symlink_to(home)
    else:
        folder.mkdir()
        folder.chmod(0o777)
    ensure_cache_folders()
    used = Path(os.environ["XDG_CACHE_HOME"])
    assert used.parent == folder.parent
    assert used != folder
    assert used.stat().st_mode & 0o777 == 0o700


def test_existing_variables_are_kept(home: Path, monkeypatch) -> None:
    cache, plots = home / "cache", home / "plots"
    monkeypatch.setenv("HOME", "/dev/null/home")
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache))
    monkeypatch.setenv("MPLCONFIGDIR", str(plots))
    ensure_cache_folders()
    assert os.environ["XDG_CACHE_HOME"] == str(cache)
    assert os.environ["MPLCONFIGDIR"] == str(plots)


@pytest.mark.slow
def test_kernels_of_a_read_only_installation_compile_without_a_home(tmp_path: Path) -> None:
    source = Path(rfpipe.__file__).parent
    installed = tmp_path / "rfpipe"
    shutil.copytree(source, installed, ignore=shutil.ignore_patterns("__pycache__"))
    for folder in (installed, *(path for path in installed.rglob("*") if path.is_dir())):
        (folder / "__pycache__").touch()  # a file, so that even root can't cache there
    environment = {name: value for name, value in os.environ.items() if name not in VARIABLES}
    environment |= {"HOME": "/dev/null/home", "PYTHONPATH": str(tmp_path), "TMPDIR": str(tmp_path)}
    code = "import rfpipe.methods.symmetric.piece_kernels; print(rfpipe.__file__)"
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == str(installed / "__init__.py")
