"""Settings changed after calibration: steps are repeated, and serving is refused."""

from __future__ import annotations

import logging
import shutil
from copy import deepcopy
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from tests.rigs.simulated_devices import SimulatedCamera, SimulatedProjector
from typer.testing import CliRunner

from rfpipe import provenance
from rfpipe.calibration import steps as calibration_steps
from rfpipe.calibration.folder import CalibrationFolder
from rfpipe.calibration.run import calibrate
from rfpipe.calibration.steps import STEPS
from rfpipe.calibration.verdicts import Findings, Verdict
from rfpipe.cli import app
from rfpipe.config import RigConfig, parse_rig_config, read_yaml
from rfpipe.config.devices import BenchConfig
from rfpipe.errors import ConfigError, InputError
from rfpipe.photometry import CameraModel
from rfpipe.rigs.build import rig_from_config
from rfpipe.rigs.calibrated import (
    Calibration,
    check_devices,
    check_settings,
    write_calibration,
)
from rfpipe.rigs.settings import flat

CONFIG = Path(__file__).parents[2] / "config"
DESK = Path(__file__).parents[1] / "examples" / "desk.py"
EVERY = tuple(STEPS)
WIDE = [[[0, 0], [9, 0], [9, 9], [0, 9]]]

# Setting, a value other than in config/rig.yaml or config/bench.yaml, and the steps to measure
# again; without steps the calibration remains valid.
CHANGES: list[tuple[str, Any, tuple[str, ...]]] = [
    ("projector.driver", "dlpc900", EVERY),
    ("projector.options.display", ":7", EVERY),
    ("projector.options.screen", 1, EVERY),
    ("projector.options.offset", [0, 2], EVERY),
    ("projector.options.shape", [600, 800], EVERY),
    ("projector.options.settle_seconds", 0.7, ("latency",)),
    ("rays", [8, 9], ("rays", "symmetry")),
    ("camera.driver", "aravis", EVERY),
    ("camera.options.shape", [100, 100], EVERY),
    ("camera.options.offset", [4, 2], EVERY),
    ("camera.options.timeout_seconds", 9.0, ()),
    ("camera.options.serial", "22710432", EVERY),
    ("camera.options.gain_db", 6.0, EVERY),
    ("camera.options.nodes", {"SensorReadoutMode": "Fast"}, EVERY),
    ("camera.options.sequence_line", "Line1", EVERY),
    ("sensor.exposures", [0.01, 0.5], EVERY),
    ("sensor.electrons_per_radiance", 1e5, EVERY),
    ("sensor.full_well_electrons", 1e4, EVERY),
    ("sensor.read_noise_electrons", 9.0, EVERY),
    ("sensor.dark_current_electrons", 9.0, EVERY),
    ("sensor.black_level_counts", 32, EVERY),
    ("sensor.bits", 10, EVERY),
    ("sensor.psf_sigma", 1.0, EVERY),
    ("sensor.vignetting", 0.1, EVERY),
    ("sensor.flare", 0.1, EVERY),
    ("sensor.bayer", "RGGB", EVERY),
    ("sensor.response_gamma", 2.0, EVERY),
    ("sensor.white_level_counts", 3000, EVERY),
    ("calibration", "elsewhere", ()),
    ("calibrate.tolerance", 0.05, ("linearity", "light", "rays", "symmetry")),
    ("calibrate.coaxial", False, EVERY),
    ("calibrate.dark_frames", 5, ("dark", "symmetry")),
    ("calibrate.levels", 5, ("transfer",)),
    ("calibrate.codes", 9, ("light",)),
    ("calibrate.period_pixels", 32, ("scene", "correspondence")),
    ("calibrate.views", [1, 1], ("rays",)),
    ("calibrate.corners", WIDE, ("rays",)),
    ("calibrate.symmetry_patterns", 5, ("symmetry",)),
    ("seed", 1, EVERY),
    ("seconds_per_pattern", 9.0, ()),
    ("bench.scene.bounces", 1, EVERY),
    ("bench.scene.surfaces", ["white", "white"], EVERY),
    ("bench.scene.shape", [16, 16], EVERY),
    ("bench.display_shape", [300, 400], EVERY),
    ("bench.camera_corners", WIDE, EVERY),
    ("bench.camera_shape", [90, 90], EVERY),
    ("bench.camera", {"bits": 12, "read_noise_electrons": 9}, EVERY),
    ("bench.projector_lens", {"aperture": 0.1}, EVERY),
    ("bench.camera_lens", {"aperture": 0.1}, EVERY),
    ("bench.projector_gamma", 1.8, EVERY),
    ("bench.projector_black", 0.1, EVERY),
    ("bench.display_delay_seconds", 0.2, EVERY),
    ("bench.ambient", 0.1, EVERY),
    ("bench.knock", [200, 0, 4], ()),
]  # fmt: skip


@cache
def plain_data(name: str) -> object:
    """Read a generated file."""
    return read_yaml(CONFIG / f"{name}.yaml")


def of_file(name: str, setting: str | None = None, value: Any = None) -> RigConfig:
    """Return the settings of a generated file, with one of them changed."""
    data: Any = deepcopy(plain_data(name))
    data["calibration"] = "calibration"
    if setting is not None:
        *groups, last = setting.split(".")
        group = data
        for key in groups:
            group = group[key]
        group[last] = value
        if last == "driver":
            group["options"] = {}
    return parse_rig_config(data, "mine.yaml")


class Calibrated:
    """A calibration whose steps only log their names, with equal descriptions of all devices."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.done: list[str] = []
        steps = {name: replace(step, measure=self._measure(name)) for name, step in STEPS.items()}
        monkeypatch.setattr(calibration_steps, "STEPS", steps)
        self.folder = CalibrationFolder(Path("calibration"))

    def _measure(self, name: str) -> Any:
        def measure(_: object) -> Findings:
            self.done.append(name)
            return Findings(Verdict("good", "It is good."))

        return measure

    def measure(self, config: RigConfig, only: list[str] | None = None) -> set[str]:
        """Run steps of the calibration, and return the names of the measured ones."""
        self.done.clear()
        shape = (4, 4)
        camera = SimulatedCamera(lambda: None, shape, 1, CameraModel())  # type: ignore[arg-type, return-value]
        steps = only or list(calibration_steps.steps_of(config.calibrate))
        calibrate(SimulatedProjector(shape), camera, self.folder, config, steps)
        return set(self.done)

    def copy_of(self, source: Path) -> None:
        """Begin with the steps and the result of another calibration."""
        shutil.copytree(source, self.folder.path)

    def write(self) -> None:
        """Write the result of the calibration, from which a rig is built."""
        settings: dict[str, Any] = {}
        for conditions in filter(None, map(self.folder.conditions, STEPS)):
            settings |= conditions.settings
        write_calibration(self.folder.path, Calibration(settings=settings))


@pytest.fixture
def calibrated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Calibrated:
    monkeypatch.chdir(tmp_path)
    return Calibrated(monkeypatch)


@pytest.fixture(scope="module")
def calibrations(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Folders of complete calibrations of the rigs of generated files."""
    folders = {}
    for name in ("rig", "bench"):
        folder = tmp_path_factory.mktemp(name)
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(folder)
            calibrated = Calibrated(patch)
            assert calibrated.measure(of_file(name)) == set(STEPS)
            calibrated.write()
        folders[name] = folder / "calibration"
    return folders


def test_each_setting_has_a_row() -> None:
    rig = of_file("rig")
    names = {*flat(rig.model_dump(mode="json")), "camera.options.nodes"}  # {} has no flat name
    names |= {f"bench.{name}" for name in BenchConfig.model_fields}
    rows = {"bench.scene" if "bench.scene" in row else row for row, _, _ in CHANGES}
    assert rows == names - {"kind", "rig", "scene", "bench"}  # not for a rig of devices


@pytest.mark.parametrize(
    ("setting", "value", "steps"), CHANGES, ids=[setting for setting, _, _ in CHANGES]
)
def test_a_changed_setting_is_measured_again_and_not_served(
    calibrated: Calibrated,
    calibrations: dict[str, Path],
    caplog: pytest.LogCaptureFixture,
    setting: str,
    value: Any,
    steps: tuple[str, ...],
) -> None:
    file = "bench" if setting.startswith("bench") else "rig"
    before, now = of_file(file), of_file(file, setting, value)
    calibrated.copy_of(calibrations[file])
    check_settings(before, "mine.yaml")
    if not steps:
        check_settings(now.model_copy(update={"calibration": "calibration"}), "mine.yaml")
        assert calibrated.measure(now) == set()
        return
    with pytest.raises(ConfigError) as refused:
        check_settings(now, "mine.yaml")
    output = str(refused.value)
    assert output.startswith("mine.yaml: ")
    assert f"{setting}" in output
    assert " was " in output
    assert ", is now " in output
    assert "rfpipe calibrate" in output
    check_settings(now, "mine.yaml", force=True)
    assert setting in caplog.text
    caplog.clear()
    with caplog.at_level(logging.INFO):
        repeated = calibrated.measure(now)
    expected = set(steps) & set(calibration_steps.steps_of(now.calibrate))
    assert repeated >= expected  # and the steps that depend on them
    assert repeated == expected or expected != set(EVERY)
    assert setting in caplog.text
    assert calibrated.measure(now) == set()


def test_the_code_of_a_user_driver_is_a_setting(
    calibrated: Calibrated, caplog: pytest.LogCaptureFixture
) -> None:
    shutil.copy(DESK, "desk.py")
    text = Path("desk.py").read_text()
    section = {"camera": {"driver": "desk.py:DeskCamera", "options": {"seed": 3}}}
    config = parse_rig_config({**section, "calibration": "calibration"}, "mine.yaml")
    assert calibrated.measure(config) == set(STEPS)
    calibrated.write()
    Path("desk.py").write_text(f"# a comment\n{text}")
    provenance._parsed.cache_clear()  # the cache of this process
    assert calibrated.measure(config) == set()
    Path("desk.py").write_text(text.replace("0.3 + 0.5", "0.2 + 0.5"))
    provenance._parsed.cache_clear()
    with pytest.raises(ConfigError, match=r"camera\.driver: its code changed"):
        rig_from_config(config)
    assert calibrated.measure(config) == set(STEPS)
    assert "camera.driver: its code changed" in caplog.text
    # an option that the calibrated driver did not have
    options = {"seed": 3, "gain": 2}
    section = {"camera": {"driver": "desk.py:DeskCamera", "options": options}}
    calibrated.write()
    changed = parse_rig_config({**section, "calibration": "calibration"}, "mine.yaml")
    with pytest.raises(ConfigError, match=r"camera\.options\.gain was null, is now 2"):
        check_settings(changed, "mine.yaml")


def test_a_step_does_not_use_steps_of_other_settings(calibrated: Calibrated) -> None:
    calibrated.measure(of_file("rig"))
    now = of_file("rig", "sensor.bits", 10)
    stale = r"linearity needs steadiness.*sensor\.bits was 12, is now 10"
    with pytest.raises(InputError, match=stale):
        calibrated.measure(now, ["linearity"])
    steps = ["steadiness", "dark", "linearity"]
    assert calibrated.measure(now, steps) == {*steps}
    # settings of other steps don't matter
    finer = of_file("rig", "calibrate.codes", 65)
    finer = finer.model_copy(update={"sensor": now.sensor})
    assert calibrated.measure(finer, ["linearity"]) == set()


@pytest.mark.parametrize("name", ["model", "serial"])
def test_another_camera_of_the_same_kind_is_refused(name: str) -> None:
    calibration = Calibration(devices={f"camera.{name}": "22710432"})
    config = of_file("rig")
    check_devices(calibration, {"camera": {name: "22710432", "codes": "ab"}}, config, "mine.yaml")
    devices = {"camera": {name: "22710433"}}
    with pytest.raises(ConfigError, match=rf"camera\.{name} was '22710432', is now '22710433'"):
        check_devices(calibration, devices, config, "mine.yaml")
    check_devices(calibration, devices, config, "mine.yaml", force=True)
    check_devices(Calibration(), devices, config, "mine.yaml")


def test_serve_refuses_before_a_device_is_opened(calibrated: Calibrated) -> None:
    calibrated.measure(of_file("rig"))
    calibrated.write()
    Path("mine.yaml").write_text("calibration: calibration\nsensor: {bits: 10}\n")
    environment = {"RFPIPE_TOKEN": "x" * 32}
    refused = CliRunner().invoke(app, ["serve", "mine.yaml", "--port", "0"], env=environment)
    assert isinstance(refused.exception, ConfigError)
    assert str(refused.exception).startswith(
        "mine.yaml: the settings changed since the calibration"
    )
    assert "sensor.bits was 12, is now 10" in str(refused.exception)
