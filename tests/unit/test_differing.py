"""Settings that differ between two descriptions, as messages list them."""

from __future__ import annotations

import pytest

from rfpipe.storage.differences import differing

VERDICTS = {"linearity": {"standing": "good", "verdict": "Exposures agree within 0.00%."}}
RIG = {
    "projector": {"codes": "0123456789abcdef" * 2, "settle_seconds": 0.1},
    "sensor": {"exposures": [0.125, 0.5], "bits": 12},
    "calibration": VERDICTS,
}


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"seed": 2}, "seed unset -> 2"),
        (
            {
                "projector": {"codes": "f" * 32, "settle_seconds": 0.1},
                "sensor": {"exposures": [0.25, 1.0], "bits": 10},
                "calibration": {"linearity": {"standing": "poor", "verdict": "Not linear."}},
            },
            (
                "sensor.bits 12 -> 10, calibration.linearity.standing good -> poor, "
                "sensor.exposures [0.125, 0.5] -> [0.25, 1.0], "
                "calibration.linearity.verdict changed, projector.codes changed"
            ),
        ),
        (
            {"more": {f"m{number:02}": "word " * 40 for number in range(20)}, "seed": 2},
            "seed unset -> 2, "
            + ", ".join(f"more.m{number:02} changed" for number in range(11))
            + ", and 9 more",
        ),
    ],
)
def test_settings_come_before_digests_and_prose(changes: dict, expected: str) -> None:
    assert differing(RIG, {**RIG, **changes}) == expected
