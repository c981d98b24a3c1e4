"""Devices of Micro-Manager: its demo camera, and a projector in software."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.emulators.micro_manager import SlmCore

from rfpipe.config.devices import RigConfig
from rfpipe.devices import micro_manager
from rfpipe.devices.micro_manager import MicroManagerCamera, MicroManagerProjector
from rfpipe.errors import CaptureError, RfpipeError
from rfpipe.photometry import CameraModel
from rfpipe.testing import CameraContract, ProjectorContract

SENSOR = CameraModel(exposures=(0.002, 0.008, 0.032), bits=12)
WAVES = {"PixelType": "16bit", "BitDepth": 12, "OnCameraCCDXSize": 40, "OnCameraCCDYSize": 30}
"""The demo camera's picture of waves, of counts in proportion to its exposure time."""


def camera(sensor: CameraModel = SENSOR, **options: Any) -> MicroManagerCamera:
    import mm_test_adapters

    adapters = mm_test_adapters.device_adapter_path()
    source = {} if "config" in options else {"library": "DemoCamera", "device": "DCam"}
    settings = {"adapters": adapters, "properties": WAVES, **source, **options}
    return MicroManagerCamera(sensor, **settings)


@pytest.mark.needs("micro_manager")
class TestDemoCamera(CameraContract):
    def make_camera(self) -> MicroManagerCamera:
        return camera()


@pytest.mark.needs("micro_manager")
def test_the_region_and_the_configuration_are_used() -> None:
    import mm_test_adapters

    with camera() as whole:
        frames = whole.expose()
        assert frames.shape == (3, 30, 40, 1)
    with camera(shape=(12, 20), offset=(6, 4)) as part:
        assert (part.expose()[..., 0].shape, part.describe()["offset"]) == ((3, 12, 20), [6, 4])
    config = Path(mm_test_adapters.device_adapter_path()) / "MMConfig_demo.cfg"
    with camera(replace(SENSOR, bayer="RGGB"), config=str(config)) as configured:
        assert configured.shape == (30, 40)  # its label, Camera, is the configuration's
        assert configured.channels == 3
        assert len(configured.describe()["config"]) == 32


@pytest.mark.needs("micro_manager")
def test_a_lost_camera_is_opened_again() -> None:
    with camera() as lost:
        expected = lost.expose().mean()
        lost._handle.unloadAllDevices()
        assert lost.expose().mean() == pytest.approx(expected, rel=0.01)
        assert lost.statistics == {"frames": 6, "failed": 0, "timed_out": 0, "reconnected": 1}


CAMERA_ERRORS = {
    "library": (
        {"library": "Nowhere"},
        "Nowhere: DCam can't be loaded.*adapters in .* fit pymm",
    ),
    "property": ({"properties": {"Bits": 12}}, "DCam: refuses Bits = 12. Valid: .*BitDepth, "),
    "value": ({"properties": {"BitDepth": 13}}, r"refuses BitDepth = 13\. Valid: 10, .*8"),
    "role": ({"device": "DWheel", "properties": {}}, "DWheel can't be loaded"),
    "bits": ({"properties": {}}, "gives 8 bits in 1 bytes per pixel; expected .* of 12 bits"),
    "colour": ({"properties": {"PixelType": "32bitRGB"}}, "gives 8 bits in 4 bytes per pixel"),
    "region": ({"shape": (99, 99)}, "can't read 99 x 99 pixels at 0, 0; the sensor has 30 x 40"),
    "source": ({"library": None}, "library and device should be set, or config"),
}


@pytest.mark.needs("micro_manager")
@pytest.mark.parametrize("name", CAMERA_ERRORS)
def test_errors_of_the_camera_are_explained(name: str) -> None:
    options, message = CAMERA_ERRORS[name]
    with pytest.raises((RfpipeError, ValueError), match=message):
        camera(**options)


@pytest.fixture
def core(monkeypatch: pytest.MonkeyPatch) -> SlmCore:
    core = SlmCore((12, 17))
    library = SimpleNamespace(CMMCore=lambda: core)
    monkeypatch.setattr(micro_manager, "load_library", lambda *_: library)
    return core


def projector(**options: Any) -> MicroManagerProjector:
    source = {} if "config" in options else {"library": "Slm", "device": "Slm"}
    return MicroManagerProjector(**{"adapters": "here", "settle_seconds": 0, **source, **options})


@pytest.mark.parametrize("bytes_per_pixel", [1, 4])
class TestSlm(ProjectorContract):
    @pytest.fixture(autouse=True)
    def _core(self, core: SlmCore, bytes_per_pixel: int) -> None:
        self.core, core.bytes_per_pixel = core, bytes_per_pixel

    def make_projector(self) -> MicroManagerProjector:
        return projector()

    def read_back(self, shown: Any) -> Any:
        del shown
        return self.core.light


def test_options_of_the_projector_reach_it(core: SlmCore, tmp_path: Path) -> None:
    config = tmp_path / "slm.cfg"
    config.write_text("Device,Slm,Slm,Slm\n")
    options = {"exposure_seconds": 0.5, "properties": {"Lamp": "On"}}
    with projector(config=str(config), **options) as shown:
        assert (core.exposure_ms, core.properties["Lamp"], core.paths) == (500, "On", ["here"])
        first = shown.describe()
    config.write_text("Device,Slm,Slm,Slm\nDelay,Slm,10\n")
    with projector(config=str(config), **options) as shown:
        assert shown.describe() != first


def test_errors_of_the_projector_are_explained(core: SlmCore) -> None:
    with pytest.raises(CaptureError, match=r"Lamp = True\. Valid: Off, On"):
        projector(properties={"Lamp": True})  # YAML's On without quotation marks
    with projector() as shown:
        core.fault = "Error in device: no reply (9)"
        with pytest.raises(CaptureError, match=r"projector Slm: .* no reply .*power and cable"):
            shown.show(np.zeros((12, 17), np.float32))


def test_a_settings_file_names_both_devices() -> None:
    options = {"adapters": "here", "library": "DemoCamera", "device": "DCam"}
    driver = {"driver": "micro_manager", "options": options}
    config = RigConfig.model_validate({"camera": driver, "projector": driver, "rays": [4, 5]})
    assert type(config.camera.options) is MicroManagerCamera.Options
    assert type(config.projector.options) is MicroManagerProjector.Options
