"""User-defined devices: one file outside the package, selected in the settings."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from tests.server.harness import running
from typer.testing import CliRunner

from rfpipe import acquire
from rfpipe.cli import app
from rfpipe.config import RigConfig, load_rig_config, parse_rig_config
from rfpipe.errors import CaptureError, ConfigError
from rfpipe.photometry import CameraModel
from rfpipe.plugins import CAMERAS, PROJECTORS, find
from rfpipe.rigs import DeviceRig
from rfpipe.rigs.build import devices_from_config, rig_from_config
from rfpipe.testing import CameraContract, ProjectorContract, RigContract

EXAMPLE = Path(__file__).parents[1] / "examples" / "desk.py"
PAIR = {
    "projector": {"driver": f"{EXAMPLE}:DeskProjector", "options": {"brightness": 0.8}},
    "camera": {"driver": f"{EXAMPLE}:DeskCamera", "options": {"seed": 3}},
    "rays": [4, 5],
}
WHOLE = {"rig": {"driver": f"{EXAMPLE}:DeskRig", "options": {"brightness": 0.5}}}


class TestDeskProjector(ProjectorContract):
    def make_projector(self):
        return find(PROJECTORS, f"{EXAMPLE}:DeskProjector")()


class TestDeskCamera(CameraContract):
    def make_camera(self):
        return find(CAMERAS, f"{EXAMPLE}:DeskCamera")(CameraModel())

    def set_light(self, camera, is_on):
        projector = find(PROJECTORS, f"{EXAMPLE}:DeskProjector")()
        projector.show(np.full(projector.shape, is_on, np.float32))
        return True


class TestRigOfSettings(RigContract):
    repeatable = False

    def make_rig(self):
        return rig_from_config(parse_rig_config(PAIR, "rig.yaml"))


def settings_file(folder: Path, settings: dict[str, Any]) -> Path:
    """Write settings that name the driver by its file beside them."""
    shutil.copy(EXAMPLE, folder)
    path = folder / "rig.yaml"
    path.write_text(yaml.safe_dump(settings).replace(str(EXAMPLE), "desk.py"))
    return path


def test_the_pair_gets_its_options_and_the_sensor(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    config = load_rig_config(settings_file(tmp_path, PAIR))
    projector, camera = devices_from_config(config)
    assert projector.describe() == {"kind": "desk projector", "brightness": 0.8}
    assert camera.describe()["seed"] == 3
    assert camera.sensor == CameraModel()
    assert RigConfig.model_validate(config.model_dump(mode="json")) == config


def test_user_devices_acquire_and_are_served(tmp_path: Path) -> None:
    config = parse_rig_config(PAIR, "rig.yaml")
    with running(lambda: rig_from_config(config)) as server, server.client() as rig:
        result = acquire(rig, "brute_force", progress=False, all_off_brackets=2, all_on_brackets=2)
    assert result.transport.projector_shape == (4, 5)
    lit = result.transport.relight(np.ones((4, 5)))[4:-4, 5:-5]
    assert lit.mean() == pytest.approx(0.8 * 0.4, rel=0.05)


def test_a_user_rig_is_one_object() -> None:
    rig = rig_from_config(parse_rig_config(WHOLE, "rig.yaml"))
    assert isinstance(rig, DeviceRig)
    assert rig.projector.describe()["brightness"] == 0.5
    with pytest.raises(ConfigError, match="expected a rig of devices"):
        devices_from_config(parse_rig_config(WHOLE, "rig.yaml"))


def test_calibration_uses_user_devices(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    quick = {"dark_frames": 4, "levels": 4, "coaxial": False}
    path = settings_file(tmp_path, {**PAIR, "calibration": "found", "calibrate": quick})
    for step in ("steadiness", "scene", "dark"):
        done = CliRunner().invoke(app, ["calibrate", str(path), "--step", step])
        assert done.exit_code == 0, done.output
        assert "report: found/report.html" in done.output
    assert (tmp_path / "found" / "steps" / "dark.json").exists()
    assert not Path("calibration").exists()
    done = CliRunner().invoke(app, ["calibrate", str(path), "--step", "scene", "-o", "other"])
    assert "report: other/report.html" in done.output
    assert "rig.yaml has calibration: found; to use the new one, set calibration: oth" in (
        " ".join(done.output.split())
    )


def test_devices_that_do_not_open_leave_no_report_of_another_rig(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = settings_file(tmp_path, {**PAIR, "calibration": "found"})
    done = CliRunner().invoke(app, ["calibrate", str(path), "--step", "scene"])
    assert "report: " in done.output
    text = (tmp_path / "desk.py").read_text().replace("self.seed = seed", "raise CaptureError('x')")
    (tmp_path / "lost.py").write_text(f"from rfpipe.errors import CaptureError\n{text}")
    path.write_text(path.read_text().replace("desk.py", "lost.py"))
    done = CliRunner().invoke(app, ["calibrate", str(path), "--step", "scene"])
    assert isinstance(done.exception, CaptureError)
    assert "report: " not in done.output


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"projector": {"driver": f"{EXAMPLE}:DeskProjector", "options": {"brightness": 2}}},
         "projector.options.brightness is 2; it should be at most 1"),
        ({"projector": {"driver": "beamer"}},
         "'beamer' is unknown; expected one of alp, dlpc900, micro_manager, window"),
        ({"bench": {}, "camera": PAIR["camera"]}, "camera.driver should be window and pylon"),
        ({**WHOLE, "calibration": "found"}, "calibration should be null with a complete rig"),
    ],
)  # fmt: skip
def test_mistakes_are_explained(settings: dict[str, Any], expected: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_rig_config(settings, "rig.yaml")
    assert expected in str(caught.value)
