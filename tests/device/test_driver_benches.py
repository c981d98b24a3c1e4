"""Each driver on its virtual device, before the bench's scene: calibrate, acquire, relight."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rfpipe import acquire
from rfpipe.calibration.folder import calibrate_rig
from rfpipe.config import parse_rig_config
from rfpipe.errors import ConfigError, InputError
from rfpipe.rigs.bench import software_bench
from rfpipe.rigs.build import rig_from_config
from rfpipe.rigs.calibrated import load_calibration
from rfpipe.scenes import scene_from_config
from rfpipe.scenes.relighting import relighting_patterns
from rfpipe.testing import RigContract

RAYS = (8, 8)


@dataclass(frozen=True)
class Kind:
    """A driver, and the sensor that its bench has."""

    driver: str
    options: dict[str, Any]
    sensor: dict[str, Any]
    channels: int
    camera_shape: tuple[int, int]
    true: dict[str, Any] | None = None


KINDS = {
    "pylon": Kind("pylon", {}, {"bits": 12, "black_level_counts": 100}, 1, (48, 52)),
    "aravis": Kind(
        "aravis", {"pixel_format": "Mono16"}, {"bits": 16, "black_level_counts": 1000}, 1, (24, 26)
    ),
    "gphoto2": Kind(
        "gphoto2",
        {},
        {"bits": 14, "black_level_counts": 512, "white_level_counts": 15_000, "bayer": "RGGB"},
        3,
        (48, 52),
    ),
    "webcam": Kind(
        "webcam",
        {"channels": 1, "skip_frames": 1},
        {"bits": 8, "black_level_counts": 20},
        1,
        (48, 52),  # of few counts it takes many pixels to tell the response
        {"bits": 8, "black_level_counts": 20, "response_gamma": 1.8},
    ),
}
ARAVIS = pytest.mark.needs("aravis")


def settings(kind: Kind, **more: Any) -> dict[str, Any]:
    return {
        "rays": list(RAYS),
        "projector": {"options": {"settle_seconds": 0.0}},
        "camera": {"driver": kind.driver, "options": kind.options},
        # such as the virtual photo camera has
        "sensor": {**kind.sensor, "exposures": [0.01, 0.05, 0.1, 1.0]},
        "bench": {
            "scene": {
                "kind": "wedge", "surfaces": ["white", "texture"], "shape": list(RAYS),
                "channels": kind.channels,
            },
            "display_shape": [72, 80],
            "camera_shape": list(kind.camera_shape),
            "camera": kind.true,
        },
        "calibrate": {
            "dark_frames": 4, "levels": 6, "codes": 9, "symmetry_patterns": 3,
            "period_pixels": 16,
        },
        **more,
    }  # fmt: skip


@pytest.fixture(params=["pylon", pytest.param("aravis", marks=ARAVIS), "gphoto2", "webcam"])
def kind(request: pytest.FixtureRequest) -> Kind:
    return KINDS[request.param]


def rig_of(kind: Kind) -> Any:
    return rig_from_config(parse_rig_config(settings(kind), "rig.yaml"))


@ARAVIS
class TestAravisBench(RigContract):
    repeatable = False

    def make_rig(self) -> Any:
        return rig_of(KINDS["aravis"])


class TestPhotoBench(RigContract):
    repeatable = False

    def make_rig(self) -> Any:
        return rig_of(KINDS["gphoto2"])


class TestWebcamBench(RigContract):
    repeatable = False

    def make_rig(self) -> Any:
        return rig_of(replace(KINDS["webcam"], true=None))  # the sensor doesn't know any gamma yet


@pytest.mark.slow
def test_calibrated_it_acquires_and_relights_the_scene(kind: Kind, tmp_path: Path) -> None:
    folder = tmp_path / "calibration"
    calibrate_rig(parse_rig_config(settings(kind), "rig.yaml"), folder)
    found = load_calibration(folder)
    true = {**kind.sensor, **(kind.true or {})}
    assert found.camera["black_level_counts"] == pytest.approx(true["black_level_counts"], abs=0.5)
    assert found.camera["full_well_electrons"] == pytest.approx(20_000, rel=0.05)
    gamma = found.camera.get("response_gamma", 1.0)
    assert gamma == pytest.approx(true.get("response_gamma", 1.0), rel=0.02)
    config = parse_rig_config(settings(kind, calibration=str(folder)), "rig.yaml")
    assert config.bench is not None
    scene = scene_from_config(config.bench.scene)
    with rig_from_config(config) as rig:  # type: ignore[attr-defined]
        transport = acquire(rig, method="near_far", progress=False).transport
    for name, pattern in relighting_patterns(RAYS).items():
        relit = transport.relight(pattern)
        light = scene.apply(pattern.reshape(1, -1)).reshape(relit.shape)
        assert np.linalg.norm(relit - light) < 0.05 * np.linalg.norm(light), name


@ARAVIS
def test_aravis_takes_sequences_as_it_takes_them_one_by_one() -> None:
    kind = KINDS["aravis"]
    triggered = replace(kind, options={**kind.options, "sequence_line": "Line0"})
    patterns = (np.random.default_rng(0).random((9, *RAYS)) < 0.5).astype(np.float32)
    given = patterns, [(1, index) for index in range(len(patterns))]
    with rig_of(triggered) as rig:
        one_by_one = rig.capture(*given).astype(float)
        frames = rig.show_sequence(*given).astype(float)
        again = rig.capture(*given).astype(float)  # by software triggers, as before
        assert rig.statistics["sequences"] == {
            "played": 4, "lost": 0, "loaded_again": 0, "one_by_one": 0
        }  # fmt: skip
    step = np.abs(one_by_one[1:] - one_by_one[:-1]).mean()
    assert np.abs(frames - one_by_one).mean() < 0.05 * step
    assert np.abs(again - one_by_one).mean() < 0.05 * step


@ARAVIS
def test_a_bench_that_its_virtual_camera_cannot_be_is_explained() -> None:
    twelve = settings(KINDS["aravis"])
    twelve["camera"]["options"] = {"pixel_format": "Mono12"}
    twelve["sensor"]["bits"] = 12
    with pytest.raises(InputError, match="fake camera, has Mono16, or a colour mosaic of 8 bits"):
        software_bench(parse_rig_config(twelve, "rig.yaml"))
    grey = settings(KINDS["gphoto2"])
    grey["bench"]["scene"]["channels"] = 1
    with pytest.raises(ConfigError, match=r"channels should be 3 with camera\.driver gphoto2"):
        parse_rig_config(grey, "rig.yaml")
