"""The table in config/README.md: the stages that run again after a change of each setting."""

from __future__ import annotations

import re
from collections.abc import Iterator
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import pytest
from pydantic import BaseModel
from tests.workflow.harness import CONFIG, ROOT, Workflow

from rfpipe.config import SceneSettings
from rfpipe.config.base import MethodSettings
from rfpipe.config.camera import CameraConfig
from rfpipe.config.model import Config

FIRST: dict[str, tuple[set[str], set[str]]] = {
    "captures": ({"capture_simulated"}, set()),
    "schedules": ({"schedule"}, set()),
    "merges": ({"merge"}, {"calibrate"}),
    "normalizations": ({"normalize"}, {"merge"}),
    "transports": ({"assemble"}, {"schedule", "capture_simulated", "merge", "refine"}),
    "verifications": ({"verification", "report"}, {"capture_simulated", "merge", "assemble"}),
    "the report": ({"report"}, {"capture_simulated", "merge", "assemble", "relight", "view"}),
    "all stages": ({"acquire"}, {"capture_simulated"}),
}
"""Beginnings of the second column: rules that a dry run names, and rules that it doesn't."""

SPECIAL: dict[str, Any] = {
    "capture.url": "http://127.0.0.1:9999",
    "capture.token_file": "a.token",
    "capture.placing": "true",
    "capture.warm_up_minutes": 1.0,
    "camera.bayer": "RGGB",
    "camera.white_level_counts": 4000,
    "camera.exposures": [0.01, 0.1, 1.0],
    "merge.divide_out_drift": True,
    "notify": "true",
    "offline.projector_shape": [10, 10],
    "report.page": True,
    "report.title": "another",
    "resources.workers": "tcp://127.0.0.1:8786",
    "resources.jobs": "acquisition",
    "scenes.tiny.shape": [6, 10],
    "scenes.tiny.channels": 1,
    "scenes.tiny.surfaces": ["texture", "texture"],
    "scenes.tiny.about": {"place": "shelf"},
    "verification.pictures": 3,
    "methods.dual.tolerance": 0.02,
}
"""Other values of settings whose types don't suggest one."""

NOT_RUN = {
    "capture.rig": "needs another rig",
    "collection": "needs a table of scenes",
    "rigs": "holds other settings",
    "rig_file": "needs the settings of a rig",
    "scenes.tiny.kind": "is another scene",
    "scenes.tiny.methods": "holds other settings",
    "scenes.tiny.rig": "names other settings",
    "scenes.tiny.settings": "holds other settings",
    "scenes.tiny.projector": "makes another rig of it",
    "methods.dual.method": "is another method",
    "storage.keep_at": "needs a bucket",
    "verification.fail_above": "needs pictures",
    "offline.calibration": "needs a calibration",
    "offline.picture_shape": "goes with camera_corners",
    "offline.camera_corners": "goes with picture_shape",
}
"""Settings that have a row, and the reason why no run is made with another value."""


def leaves(model: type[BaseModel], above: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the path and field of each setting of a model and its groups."""
    for name, field in model.model_fields.items():
        path = f"{above}{name}"
        groups = [
            kind for kind in (field.annotation, *get_args(field.annotation)) if is_group(kind)
        ]
        if path == "scenes":
            yield from leaves(SceneSettings.model_of("wedge"), "scenes.tiny.")
        elif path == "methods":
            yield from leaves(MethodSettings.model_of("dual"), "methods.dual.")
        elif groups and not above:
            yield from leaves(groups[0], f"{path}.")
        else:
            yield path, field


def is_group(kind: object) -> bool:
    return isinstance(kind, type) and issubclass(kind, BaseModel) and kind is not MethodSettings


def rows() -> dict[str, str]:
    """Read the table: the stages that run again, by the name pattern of settings."""
    text = (ROOT / "config" / "README.md").read_text(encoding="utf-8")
    table = text.partition("| setting | runs again |\n|---|---|\n")[2].partition("\n\n")[0]
    runs_of_setting: dict[str, str] = {}
    for line in table.splitlines():
        names, runs = (cell.strip() for cell in line.strip("|").split("|"))
        for name in re.findall(r"`([^`]+)`", names):
            assert name not in runs_of_setting, f"{name} has two rows"
            runs_of_setting[name] = runs
    return runs_of_setting


TABLE = rows()
SETTINGS = dict(leaves(Config))


def row_of(path: str) -> str:
    """Return the most specific pattern of the table that matches a setting."""
    fitting = [name for name in TABLE if fits(path, name)]
    assert fitting, f"{path} has no row in config/README.md"
    return max(fitting, key=lambda name: (name.count("."), len(name)))


def fits(path: str, pattern: str) -> bool:
    parts, pattern_parts = path.split("."), pattern.split(".")
    return len(pattern_parts) <= len(parts) and all(
        fnmatchcase(part, pattern_part)
        for part, pattern_part in zip(parts, pattern_parts, strict=False)
    )


def other_value(path: str, field: Any, default: Any) -> Any:
    """Return a valid value of a setting other than the current one."""
    if path in SPECIAL:
        return SPECIAL[path]
    choices = literals(field.annotation)
    if choices:
        return next(choice for choice in choices if choice != default)
    if isinstance(default, bool):
        return not default
    if isinstance(default, int):
        return default + 1
    if isinstance(default, float):
        return default * 0.9 if default else 0.01
    raise AssertionError(f"{path}: say another value than {default} in SPECIAL")


def literals(annotation: Any) -> tuple[Any, ...]:
    if get_origin(annotation) is Literal:
        return get_args(annotation)
    return next(filter(None, map(literals, get_args(annotation))), ())


def test_every_setting_has_a_row_and_every_row_a_setting() -> None:
    used = {row_of(path) for path in SETTINGS}
    unused = set(TABLE) - used - {"rigs", "camera"}
    assert not unused, f"rows of no setting: {unused}"
    assert len(SETTINGS) > 55
    assert set(NOT_RUN) <= set(SETTINGS)


def test_every_row_names_the_stages_that_run_again() -> None:
    for name, runs in TABLE.items():
        begins = (*FIRST, "nothing", "as the settings", "captures of an offline rig")
        assert runs.startswith(begins), (name, runs)


SCENES = {"tiny": {"kind": "wedge", "surfaces": ["white", "texture"], "shape": [6, 8]}}
BASE: dict[str, Any] = {
    "scenes": SCENES, "methods": {"dual": {"tolerance": 0.1}},
    "capture": {**CONFIG["capture"], "batch_patterns": 16},
}  # fmt: skip


@pytest.fixture(scope="session")
def finished(shared: Path, kernels: None) -> Workflow:
    """A small complete run; read only."""
    from tests.workflow.conftest import _once

    def run(workflow: Workflow) -> str:
        workflow.configure(**BASE)
        return workflow.run()

    return _once(shared / "finished", run)


def planned(workflow: Workflow) -> set[str]:
    """Names of the rules that a dry run lists."""
    output = workflow.run("--dry-run")
    stats = re.search(r"^job +count\n-+.*?\n(.*?)^total", output, re.MULTILINE | re.DOTALL)
    names = stats[1].split("\n") if stats else []
    return {line.split()[0] for line in names if line.strip()} - {"all"}


def changed(path: str, value: Any) -> dict[str, Any]:
    """Return the settings of the run with one value changed."""
    settings: dict[str, Any] = {**CONFIG, **BASE}
    group, *names = path.split(".")
    if not names:
        return {**settings, group: value}
    inner: Any = settings.get(group) or {}
    copied = top = {key: dict(it) if isinstance(it, dict) else it for key, it in inner.items()}
    for name in names[:-1]:
        copied = copied[name]
    copied[names[-1]] = value
    return {**settings, group: top}


@pytest.mark.slow
@pytest.mark.parametrize("path", sorted(set(SETTINGS) - set(NOT_RUN)))
def test_a_change_runs_the_stages_of_the_table_again(
    path: str, finished: Workflow, tmp_path: Path
) -> None:
    import yaml

    default: Any = Config.model_validate({**CONFIG, **BASE})
    for name in path.split("."):
        default = default[name] if isinstance(default, dict) else getattr(default, name)
    workflow = Workflow(finished.folder)
    workflow.config = tmp_path / "config.yaml"
    settings = changed(path, other_value(path, SETTINGS[path], default))
    workflow.config.write_text(yaml.safe_dump(settings))
    named, runs = planned(workflow), TABLE[row_of(path)]
    if path == "capture.keep_raw":
        assert named == {"drop_raw"}
    elif runs.startswith("nothing"):
        assert not named
    else:
        begins = "the report" if path.startswith("offline") else runs
        rules, excluded_rules = next(FIRST[prefix] for prefix in FIRST if begins.startswith(prefix))
        assert rules <= named
        assert not excluded_rules & named


@pytest.mark.slow
def test_without_a_change_no_rule_is_listed(finished: Workflow) -> None:
    assert planned(finished) == set()
    listed = finished.run("--list-changes", "params")
    assert "results/" not in listed


def test_the_table_covers_the_settings_of_the_camera() -> None:
    of_camera = {f"camera.{name}" for name in CameraConfig.model_fields}
    assert of_camera <= set(SETTINGS)
