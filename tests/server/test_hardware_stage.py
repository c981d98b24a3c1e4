"""The capture stage of a rig behind a server, and the stages after it, on files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.server.harness import TOKEN, ResampledRig, Running, running
from tests.workflow.stagewise import SETTINGS, SHAPE, StagewiseAcquisition

from rfpipe import acquire
from rfpipe.errors import CaptureError
from rfpipe.stages.capture import read_sensor
from rfpipe.stages.context import Acquisition
from rfpipe.stages.plan import Plan
from rfpipe.stages.rig_sources import RemoteSource
from rfpipe.transport import open_transport


class RemoteAcquisition(StagewiseAcquisition):
    """Dual photography of a resampled rig behind a server."""

    def __init__(self, path: Path, url: str, camera_shape: tuple[int, ...] = SHAPE) -> None:
        super().__init__(path / "results", None)
        self.plan = Plan.of("dual", "dual", (camera_shape, SHAPE, 3), {"tolerance": 1e-3})
        self.url = url
        self.token = path / "rig.token"
        self.token.write_text(TOKEN)
        self.token.chmod(0o600)

        self.settings = replace(SETTINGS, all_off_brackets=8, all_on_brackets=64)

    def context(self, **settings: Any) -> Acquisition:
        rays = {
            "camera_shape": self.plan.camera.shape, "projector_shape": SHAPE, "channels": 3
        }  # fmt: skip
        source = RemoteSource(rays, self.url, str(self.token), patience_seconds=0.0)
        return replace(super().context(**settings), rig_source=source)


@pytest.fixture(scope="module")
def acquired(tmp_path_factory: pytest.TempPathFactory) -> RemoteAcquisition:
    """Acquire all levels, then stop the server."""
    with running(ResampledRig()) as server:
        acquisition = RemoteAcquisition(tmp_path_factory.mktemp("rig"), server.url)
        acquisition.acquire_levels()
        acquisition.assemble()
    return acquisition


def test_a_resampled_sensor_is_restored_from_its_capture(
    acquired: RemoteAcquisition,
) -> None:
    packed = open_transport(acquired.folder.path / "transport.zarr").pack("float32")
    settings = {"watch": "off", "verification": 0, "progress": False}
    settings |= {"all_off_brackets": 8, "all_on_brackets": 64}
    result = acquire(ResampledRig(), "dual", tolerance=1e-3, **settings)  # type: ignore[arg-type]
    expected = result.transport.pack("float32")
    assert packed[1] == expected[1]
    for name, array in expected[0].items():
        np.testing.assert_array_equal(packed[0][name], array, err_msg=name)
    sensor = ResampledRig().sensor
    assert read_sensor(acquired.folder).describe() == sensor.describe()


@pytest.fixture
def server() -> Any:
    with running(ResampledRig()) as server:
        yield server


def test_a_rig_that_differs_from_the_plan_is_refused(tmp_path: Path, server: Running) -> None:
    acquisition = RemoteAcquisition(tmp_path, server.url, camera_shape=(8, 5))
    acquisition.schedule(0)
    with pytest.raises(CaptureError, match=r"has .*\(4, 5\).* say .*\(8, 5\)"):
        acquisition.capture(0)
    with server.http() as http:
        assert http.get("/v1/status").json()["brackets"] == 0


def test_a_changed_rig_is_refused(tmp_path: Path) -> None:
    rig = ResampledRig()
    with running(rig) as server:
        acquisition = RemoteAcquisition(tmp_path, server.url)
        acquisition.level(0)
    rig.raw.seed = 5
    acquisition.schedule(1)
    with running(rig) as server:
        acquisition.url = server.url
        with pytest.raises(CaptureError, match=r"not that of the patterns .*seed 0 -> 5"):
            acquisition.capture(1)
