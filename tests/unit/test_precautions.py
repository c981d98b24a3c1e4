"""Check and verification pictures of real rigs, in runs and by `rfpipe.acquire`."""

from __future__ import annotations

from typing import Any

import pytest
from tests.rigs.displaced_rigs import SHAPE, Knocked, beside, wedge
from tests.rigs.known_matrix import settings_of_a_plane

import rfpipe
from rfpipe.config import parse_config
from rfpipe.config.capture import PRECAUTIONS
from rfpipe.errors import CaptureError, InputError
from rfpipe.photometry import CameraModel
from rfpipe.rigs.base import is_simulated
from rfpipe.stages import acquire as module
from rfpipe.stages.settings import operating_settings, stage_settings
from rfpipe.units import CHECK_PICTURE_KEY, VERIFICATION_KEY

FEW = {"all_on_brackets": 8, "progress": False, "symmetry_brackets": 0, "tolerance": 1e-2}


class Real:
    """A rig that isn't marked as simulated."""

    def __init__(self, rig: Any) -> None:
        self._rig, self.keys = rig, list[tuple[int, ...]]()

    def __getattr__(self, name: str) -> Any:
        if name == "is_simulated":
            raise AttributeError(name)
        return getattr(self._rig, name)

    def capture(self, patterns: Any, keys: Any) -> Any:
        self.keys += map(tuple, keys)
        return self._rig.capture(patterns, keys)


def rig() -> rfpipe.OperatorRig:
    return rfpipe.OperatorRig(list(wedge()), SHAPE, SHAPE, CameraModel())


def kinds_of(keys: list[tuple[int, ...]]) -> set[int]:
    return {key[0] for key in keys} & {CHECK_PICTURE_KEY, VERIFICATION_KEY}


@pytest.mark.parametrize(
    ("options", "pictures", "kinds"),
    [
        ({}, 9, {CHECK_PICTURE_KEY, VERIFICATION_KEY}),
        ({"verification": 0}, 0, {CHECK_PICTURE_KEY}),
        ({"watch": "off", "verification": 2}, 2, {VERIFICATION_KEY}),
    ],
)
def test_a_real_rig_is_watched_and_verified(
    options: dict[str, Any], pictures: int, kinds: set[int]
) -> None:
    real = Real(rig())
    verification = rfpipe.acquire(real, "dual", **options, **FEW).verification
    assert (0 if verification is None else len(verification.table)) == pictures
    assert kinds_of(real.keys) == kinds


def test_a_simulated_rig_is_watched_and_verified_only_on_request() -> None:
    simulated = Knocked(wedge(), wedge(), 10_000, CameraModel())
    assert is_simulated(simulated)
    assert rfpipe.acquire(simulated, "dual", **FEW).verification is None
    assert kinds_of(simulated.keys) == set()
    for mode in ("refuse", "warn"):
        watched = Real(rig())
        watched.is_simulated = True
        rfpipe.acquire(watched, "dual", watch=mode, **FEW)
        assert kinds_of(watched.keys) == {CHECK_PICTURE_KEY}
    with pytest.raises(InputError, match="watch is 'on'; expected one of off, warn, refuse"):
        rfpipe.acquire(simulated, "dual", watch="on", **FEW)


def test_a_camera_that_moves_ends_an_acquisition() -> None:
    knocked = Real(Knocked(wedge(), beside(wedge(), 1.0), 30, CameraModel()))
    with pytest.raises(CaptureError, match=r"the rig or the scene moved.*watch='warn'"):
        rfpipe.acquire(knocked, "dual", **FEW)
    assert len(knocked._rig.keys) < 45


@pytest.mark.parametrize("kind", PRECAUTIONS)
def test_runs_and_acquire_use_the_same_defaults(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    vase = {"kind": "captured", "shape": [8, 8]}
    settings = settings_of_a_plane() if kind == "simulated" else parse_config(
        {"scenes": {"plane": vase}, "methods": {"dual": {}}, "capture": {"rig": kind}}, "c"
    )  # fmt: skip
    (_, method), *_ = settings.acquisitions
    stages = stage_settings(settings, "plane", method)
    of_run = PRECAUTIONS[kind]  # type: ignore[index]
    assert operating_settings(settings, "plane")["watch"] == of_run.watch
    assert stages["check_interval"] == of_run.check_interval
    assert stages["divide_out_drift"] == of_run.divide_out_drift
    assert settings.verification_pictures == of_run.verification_pictures
    if kind == "offline":
        return
    acquisitions = []

    def levels(acquisition: Any) -> None:
        acquisitions.append(acquisition)
        raise CaptureError("stopped")

    monkeypatch.setattr(module, "acquire_levels", levels)
    with pytest.raises(CaptureError, match="stopped"):
        rfpipe.acquire(rig() if kind == "simulated" else Real(rig()), "dual")
    [acquisition] = acquisitions
    assert acquisition.settings.watch == of_run.watch
    assert acquisition.settings.divide_out_drift == of_run.divide_out_drift
