"""The driver of GenICam cameras, with Aravis' fake cameras in process and by GigE Vision."""

import ctypes
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.emulators.aravis_cameras import FilledCamera, enable_fake, gige_camera
from tests.services.waiting import wait_until

from rfpipe.devices import aravis_library
from rfpipe.devices.aravis import AravisCamera
from rfpipe.devices.aravis_library import AravisNodes
from rfpipe.errors import CaptureError
from rfpipe.photometry import CameraModel
from rfpipe.testing import CameraContract

SENSOR = CameraModel(exposures=(0.001, 0.01, 0.1), bits=16)
SHAPE = (40, 48)
PICTURE = np.random.default_rng(0).integers(0, 2**16, SHAPE)
QUICK = {"timeout_seconds": 1.5}


pytestmark = pytest.mark.needs("aravis")


class TestCameraWithMosaic(CameraContract):
    def make_camera(self) -> AravisCamera:
        return FilledCamera(PICTURE >> 8, replace(SENSOR, bits=8, bayer="GRBG"))


@pytest.mark.parametrize(
    ("bits", "bayer", "name"),
    [(8, None, "Mono8"), (16, None, "Mono16"), (8, "RGGB", "BayerRG8"), (8, "GBRG", "BayerGB8"),
     (8, "GRBG", "BayerGR8"), (8, "BGGR", "BayerBG8")],
)  # fmt: skip
def test_counts_arrive_bit_for_bit(bits: int, bayer: str | None, name: str) -> None:
    picture = PICTURE >> (16 - bits)
    with FilledCamera(picture, replace(SENSOR, bits=bits, bayer=bayer)) as camera:
        assert camera.describe()["pixel_format"] == name
        assert (camera.expose().reshape(3, *SHAPE) == picture).all()


def test_automatic_functions_are_off_and_frames_are_triggered_with_exact_exposures(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    times = []

    def look(camera: AravisCamera, _: float) -> None:
        times.append(camera.nodes.number("ExposureTimeAbs"))

    monkeypatch.setattr(AravisCamera, "_before_trigger", look)
    with FilledCamera(PICTURE, SENSOR, offset=(8, 16)) as camera:
        nodes = camera.nodes
        assert nodes.write("GainAuto", "Off") == "Off"
        for name, value in (("GainRaw", 0), ("OffsetY", 8), ("OffsetX", 16)):
            assert nodes.number(name) == value
        request = "arv_device_get_string_feature_value", nodes.device, b"TriggerMode"
        assert aravis_library.checked_call(*request) == b"On"
        camera.expose()
    assert times == [1000, 10_000, 100_000]


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"shape": (40, 30_000)}, r"refuses Width = 30000.*Valid: 1 to 2048"),
        ({"nodes": {"Sharpnes": 1}}, "refuses Sharpnes = 1: the camera has no such setting"),
        ({"nodes": {"TriggerActivation": "Maybe"}}, "Valid: RisingEdge"),
        ({"gain_db": 3.0}, "has no gain in decibels"),
    ],
)
def test_refused_settings_are_explained(changes: dict[str, Any], expected: str) -> None:
    enable_fake()
    with pytest.raises(CaptureError, match=expected):
        AravisCamera(SENSOR, **{"shape": SHAPE, "serial": "1", **QUICK, **changes})


def test_a_missing_library_names_the_package_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(aravis_library, "_LIBRARY", "libaravis-of-nobody.so.0")
    aravis_library.load_aravis.cache_clear()
    try:
        with pytest.raises(CaptureError, match=r"apt-get install libaravis-0\.8-0"):
            AravisCamera(SENSOR)
    finally:
        aravis_library.load_aravis.cache_clear()


def test_a_lost_camera_is_reconnected(monkeypatch: pytest.MonkeyPatch) -> None:
    first, execute = iter([True]), AravisNodes.execute

    def failing(nodes: AravisNodes, name: str) -> None:
        if name == "TriggerSoftware" and next(first, False):
            raise aravis_library.AravisError("Timeout waiting for device response")
        execute(nodes, name)

    monkeypatch.setattr(AravisNodes, "execute", failing)
    with FilledCamera(PICTURE, SENSOR, **QUICK) as camera:
        assert (camera.expose().reshape(3, *SHAPE) == PICTURE).all()
        assert camera.statistics == {"frames": 3, "failed": 0, "timed_out": 0, "reconnected": 1}


def test_each_trigger_delivers_a_frame_in_order() -> None:
    with (
        gige_camera("RFPIPE1"),
        AravisCamera(
            SENSOR, serial="RFPIPE1", shape=SHAPE, sequence_line="Software", **QUICK
        ) as camera,
    ):
        count, came = aravis_library.load_aravis()[0].arv_stream_get_n_buffers, ctypes.c_int()
        for _ in range(2):
            camera.arm(0.02, 4)
            for number in range(4):  # it has no memory for a second trigger before the frame
                camera.nodes.execute("TriggerSoftware")

                def has_come(number: int = number) -> bool:
                    count(ctypes.c_void_p(camera._stream), None, ctypes.byref(came))
                    return came.value > number

                wait_until(has_come, "the frame")
            frames = camera.collect()
            assert frames.shape == (4, *SHAPE, 1)
            # its ramp moves on by as much at each frame, but for rounding
            steps = np.diff(frames[:, 0, 0, 0].astype(int))
            assert steps[0] > 100
            assert np.abs(steps - steps[0]).max() <= 1
        assert camera.statistics == {"frames": 8, "failed": 0, "timed_out": 0, "reconnected": 0}
        assert camera.expose().shape == (3, *SHAPE, 1)
        assert camera.seconds_between(0.1) == pytest.approx(0.105)
        assert camera.seconds_between(1e-5) == pytest.approx(1.05 / 1000)  # as it says of itself
