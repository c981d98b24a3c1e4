"""``requirements.lock`` holds pyproject's dependencies: versions and hashes, no addresses."""

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
LOCK = (ROOT / "requirements.lock").read_text(encoding="utf-8")


def name_of(requirement: str) -> str:
    return re.split(r"[^A-Za-z0-9._-]", requirement.strip(), maxsplit=1)[0].lower()


def test_lock_holds_every_direct_dependency() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    direct = {name_of(requirement) for requirement in sum(extras.values(), project["dependencies"])}
    assert f"{project['name']}[mitsuba,rig]" in extras["dev"]
    locked = {name_of(line) for line in LOCK.splitlines() if "==" in line}
    assert direct - {project["name"]} <= locked


def test_lock_pins_by_hash_and_names_no_address() -> None:
    for entry in re.split(r"\n(?=\S)", LOCK.strip()):
        assert re.match(r"[a-z0-9._-]+==\S+ .*\\\n", entry), entry
        assert "--hash=sha256:" in entry
    assert not re.search(r"://|--index|--find|--extra|@", LOCK)
