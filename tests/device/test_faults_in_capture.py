"""Six faults that begin during a capture: each is named correctly and stops the capture early."""

from __future__ import annotations

import logging
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tests.device.test_fault_table import FAULTS
from tests.rigs.coaxial_rig import RAYS, coaxial_rig, darker
from tests.workflow.stagewise import SETTINGS
from tests.workflow.stagewise import acquire as acquire_on_files

import rfpipe
from rfpipe.errors import CaptureError
from rfpipe.rigs import DeviceRig, stale
from rfpipe.stages import verification
from rfpipe.stages.context import CaptureContext
from rfpipe.stages.plan import Plan
from rfpipe.stages.rig_sources import GivenRig
from rfpipe.storage.base import VERIFICATION_MANIFEST
from rfpipe.store import read_manifest
from rfpipe.testing import faults

BEGINNING, LATER = 0, 18
"""Number of pictures before a fault: 0, or all of level 0 with its check pictures and some more."""

HARMLESS = {"drift", "late"}
"""Faults that the capture corrects: drift is divided out, late pictures are repeated."""

NAMED = {name: case.message for name, case in FAULTS.items()}


def acquired(rig: DeviceRig, method: str = "auto", **changes: Any) -> Any:
    options = {"target_error": 0.03, "progress": False, "verification": 3, **changes}
    return rfpipe.acquire(rig, method, **options)


@pytest.fixture(autouse=True)
def _at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stale, "RETAKE_SECONDS", 0.0)


@pytest.mark.parametrize("after", [BEGINNING, LATER])
@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_named_and_ends_the_capture_early(
    name: str, after: int, caplog: pytest.LogCaptureFixture
) -> None:
    rig = coaxial_rig(FAULTS[name].inject, after)
    if name in HARMLESS:
        with caplog.at_level(logging.WARNING):
            result = acquired(rig)
        output = caplog.text
        steady = acquired(coaxial_rig())
        assert result.patterns == steady.patterns  # no asymmetry is suspected
        assert result.verification.mean_error < 1.1 * steady.verification.mean_error
    else:
        with pytest.raises(CaptureError) as caught:
            acquired(rig)
        output = str(caught.value)
        assert "warn" in output  # how to go on all the same
        assert rig.camera.count <= after + 100  # type: ignore[attr-defined]
    assert re.search(NAMED[name], output, re.S), output
    unrelated = set(NAMED) - {name, "geometry"}
    assert [fault for fault in unrelated if re.search(NAMED[fault], output, re.S)] == []


@pytest.mark.parametrize("name", sorted(set(FAULTS) - HARMLESS))
def test_a_fault_only_warns_with_watch_warn(name: str, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        acquired(coaxial_rig(FAULTS[name].inject, LATER), watch="warn", method="near_far")
    assert re.search(NAMED[name], caplog.text, re.S), caplog.text


def test_gain_that_changes_from_picture_to_picture_is_not_divided_out(
    caplog: pytest.LogCaptureFixture,
) -> None:
    rig = coaxial_rig(FAULTS["gain"].inject, camera=darker(2))
    with caplog.at_level(logging.WARNING):
        result = acquired(rig, watch="warn", method="near_far", asymmetry=0.5)
    assert "it is divided out" not in caplog.text
    assert "it can't be divided out: switch automatic gain" in caplog.text
    assert result.verification.against(0.03).verdict == "missed"
    assert "the target is missed" in caplog.text


@pytest.mark.parametrize(
    ("name", "target", "verdict", "alarm"),
    [
        ("gain", 0.02, "missed", "level 0: gain changes from picture to picture"),
        ("geometry", 0.04, "met", "level 0: this rig was coaxial when it was calibrated"),
        (None, 0.04, "met", None),
    ],
)
def test_the_files_state_target_error_and_reason(
    tmp_path: Path, name: str | None, target: float, verdict: str, alarm: str | None
) -> None:
    rig = coaxial_rig(FAULTS[name].inject if name else None, camera=darker(2))
    settings = replace(
        SETTINGS, all_off_brackets=8, all_on_brackets=16, symmetry_brackets=6, watch="warn",
        check_interval=8, accepted_asymmetry=0.05, divide_out_drift=True,
    )  # fmt: skip
    accepted = 0.05 if name != "gain" else 0.9  # not to go on as on a rig that isn't coaxial
    plan = Plan.of("auto", "auto", (RAYS, RAYS, 1), {"target_error": target}, accepted)
    folder = acquire_on_files(tmp_path / "matrix" / "auto", rig, plan, settings)
    verification.run(CaptureContext(folder, settings, rig_source=GivenRig(rig)), 3)
    stated = read_manifest(folder.path / VERIFICATION_MANIFEST)
    assert stated["target_error"] == target
    assert stated["verdict"] == verdict
    assert f"{stated['mean_error']:.2%}" in stated["reason"]
    assert f"{target:.2%}" in stated["reason"]
    if alarm:
        assert any(text.startswith(alarm) for text in stated["alarms"])
    else:
        assert not stated["alarms"]
    if verdict == "missed":
        assert stated["reason"].endswith("gain changes from picture to picture")


@pytest.mark.parametrize("after", [2, 4, LATER])
def test_half_the_light_lost_is_not_reported_as_gain(after: int) -> None:
    rig = coaxial_rig(
        lambda projector, camera, at: (faults.half_dark(projector, at), camera), after
    )
    with pytest.raises(CaptureError) as caught:
        acquired(rig)
    output = str(caught.value)
    assert re.search(r"moved.*partly dark", output)
    assert not [name for name in set(NAMED) - {"geometry"} if re.search(NAMED[name], output, re.S)]


@pytest.mark.parametrize("method", ["auto", "near_far", "dual"])
@pytest.mark.parametrize(
    ("inject", "place"),
    [
        (faults.mirrored, "mirrored left to right"),
        (faults.half_dark, "right edge"),
    ],
)
def test_a_rig_that_differs_from_its_calibration_is_refused(inject, place, method) -> None:
    def projecting(projector, camera, after):
        return inject(projector, after), camera

    options = {"progress": False, **({} if method == "dual" else {"target_error": 0.03})}
    output = rf"was coaxial when it was calibrated; it no longer is: .*{place}.*calibrate again"
    with pytest.raises(CaptureError, match=output):
        rfpipe.acquire(coaxial_rig(projecting), method, **options)
    if method == "dual":  # users can allow it
        rfpipe.acquire(
            coaxial_rig(projecting), method, watch="warn", tolerance=0.05, verification=0, **options
        )


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(500, 524))
@pytest.mark.parametrize("factor", [1, 16])
def test_a_clean_capture_gives_no_alarm(
    factor: float, seed: int, caplog: pytest.LogCaptureFixture
) -> None:
    rig = coaxial_rig(seed=seed, camera=darker(factor))
    with caplog.at_level(logging.WARNING):
        acquired(rig)
    assert caplog.text == ""
    assert rig.statistics["brackets"]["stale"] == 0
