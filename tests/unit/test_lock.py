"""``requirements.lock``: versions and hashes of all dependencies, without addresses."""

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LOCK, VALIDATORS = (
    (ROOT / name).read_text(encoding="utf-8") for name in ("requirements.lock", "validators.lock")
)


def name_of(requirement: str) -> str:
    return re.split(r"[^A-Za-z0-9._-]", requirement.strip(), maxsplit=1)[0].lower()


def test_lock_contains_every_direct_dependency() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    del extras["torch"]  # its CUDA packages take gigabytes; .ci/run installs it
    direct = {name_of(requirement) for requirement in sum(extras.values(), project["dependencies"])}
    all_extras = ",".join(sorted(set(extras) - {"dev"}))
    assert f"{project['name']}[{all_extras}]" in extras["dev"]
    locked = {name_of(line) for line in LOCK.splitlines() if "==" in line}
    assert direct - {project["name"]} <= locked


@pytest.mark.parametrize("lock", [LOCK, VALIDATORS], ids=["requirements", "validators"])
def test_lock_pins_by_hash_and_names_no_address(lock: str) -> None:
    for entry in re.split(r"\n(?=\S)", lock.strip()):
        assert re.match(r"[a-z0-9._-]+==\S+ .*\\\n", entry), entry
        assert "--hash=sha256:" in entry
    assert not re.search(r"://|--index|--find|--extra|@", lock)
