"""Contents and metadata of the wheel and the sdist in ``dist``."""

from __future__ import annotations

import subprocess
import sys
import tomllib
import zipfile
from email import message_from_bytes
from pathlib import Path

import pytest
from packaging.metadata import Metadata
from packaging.specifiers import SpecifierSet
from tests.machine.pythons import installed_pythons

import rfpipe

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
BUILD = (sys.executable, "-m", "uv", "build", "--quiet", "--no-build-isolation", "--offline")


def sources() -> dict[str, Path]:
    """Return the tracked files that belong into the wheel, by their names in it."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True)
    wheel = PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]
    files = {}
    for name in listed.stdout.decode().strip("\0").split("\0"):
        if name.startswith("src/rfpipe/"):
            files[name.removeprefix("src/")] = ROOT / name
        for source, target in wheel["force-include"].items():
            if name == source or name.startswith(f"{source}/"):
                files[target + name.removeprefix(source)] = ROOT / name
    return files


def test_the_wheel_contains_the_sources_alone(release: Path) -> None:
    with zipfile.ZipFile(release) as wheel:
        assert wheel.testzip() is None
        contents = {
            name: wheel.read(name) for name in wheel.namelist() if ".dist-info/" not in name
        }
    differing = [
        name for name, path in sources().items() if contents.get(name) != path.read_bytes()
    ]
    assert not differing, "run make dist again"
    assert sorted(contents) == sorted(sources())


def test_the_sdist_builds_the_same_wheel(release: Path, tmp_path: Path) -> None:
    (sdist,) = release.parent.glob("*.tar.gz")
    subprocess.run([*BUILD, "--wheel", "--out-dir", tmp_path, sdist], check=True)
    assert (tmp_path / release.name).read_bytes() == release.read_bytes()


def test_the_metadata_are_valid(release: Path) -> None:
    with zipfile.ZipFile(release) as wheel:
        (name,) = (name for name in wheel.namelist() if name.endswith(".dist-info/METADATA"))
        content = wheel.read(name)
        assert name.replace("METADATA", "licenses/LICENSE") in wheel.namelist()
    metadata = Metadata.from_email(content, validate=True)
    assert (metadata.name, str(metadata.version)) == (
        PROJECT["project"]["name"],
        rfpipe.__version__,
    )
    assert metadata.requires_python == SpecifierSet(PROJECT["project"]["requires-python"])
    assert set(metadata.provides_extra or []) == set(PROJECT["project"]["optional-dependencies"])
    assert message_from_bytes(content)["Description-Content-Type"] == "text/markdown"


@pytest.mark.parametrize("python", installed_pythons())
def test_the_classifiers_name_the_pythons_that_are_tried(python: str) -> None:
    assert f"Programming Language :: Python :: {python}" in PROJECT["project"]["classifiers"]
