"""Verdicts on the rig's calibration in a run's report and warnings."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from rfpipe.errors import ConfigError
from rfpipe.report.text import rig_standing
from rfpipe.report.verification import verdicts_section
from rfpipe.rigs.calibrated import VERDICTS_KEY, check_verdicts, warn_of
from rfpipe.store import write_manifest

VERDICTS = {
    "dark": {"title": "Black level", "standing": "good", "verdict": "64 counts."},
    "rays": {"title": "Rays", "standing": "poor", "verdict": "Half of them are not seen."},
    "symmetry": {"title": "Symmetry", "standing": "unknown", "verdict": "Too noisy."},
}


def inputs_of(folder: Path, rig: dict[str, Any]) -> Any:
    run = SimpleNamespace(scene="desk", method="auto")
    place = folder / "desk" / "auto" / "L00"
    place.mkdir(parents=True)
    write_manifest(place / "capture.json", {"rig": rig})
    return SimpleNamespace(results=folder, runs=[run])


@pytest.mark.parametrize(
    ("verdicts", "message", "rows"),
    [
        (VERDICTS, "desk by auto: Rays: NOT GOOD. Half of them are not seen.",
         [["Black level", "good"], ["Rays", "NOT GOOD"], ["Symmetry", "can't tell"]]),
        ({}, "desk by auto: without a calibration; pictures may not be radiance.",
         [["no calibration", "can't tell"]]),
    ],
)  # fmt: skip
def test_a_report_shows_the_verdicts_on_its_rig(
    tmp_path: Path, verdicts: dict[str, Any], message: str, rows: list[list[str]]
) -> None:
    rig = {"kind": "devices", VERDICTS_KEY: verdicts}
    section = verdicts_section(inputs_of(tmp_path, rig))
    assert rig_standing(rig) == ("NOT GOOD" if verdicts else "no calibration")
    assert section.text == [message]
    assert section.blocks[0].rows == rows
    assert not verdicts_section(inputs_of(tmp_path / "other", {"kind": "simulated"})).blocks


def test_a_run_warns_of_a_rig_that_is_not_good(caplog: pytest.LogCaptureFixture) -> None:
    warn_of({VERDICTS_KEY: VERDICTS}, "http://rig")
    [record] = caplog.records
    assert "http://rig: its calibration is not good. Rays" in record.message
    warn_of({}, "http://rig")
    assert len(caplog.records) == 1


def test_a_poor_calibration_is_refused_unless_forced(caplog: pytest.LogCaptureFixture) -> None:
    with pytest.raises(ConfigError, match=r"(?s)mine: the calibration is not good.*Rays.*--force"):
        check_verdicts(VERDICTS, "mine", force=False)
    check_verdicts(VERDICTS, "mine", force=True)
    assert "Half of them" in caplog.text
    good = {name: verdict for name, verdict in VERDICTS.items() if name != "rays"}
    check_verdicts(good, "mine", force=False)
    check_verdicts({}, None, force=False)
    assert "has no calibration" in caplog.text
