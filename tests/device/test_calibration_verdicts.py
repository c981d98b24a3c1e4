"""Verdicts and causes for common faults of rigs, on the simulated bench.

Each calibration also writes a report.
"""

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from rfpipe.calibration.folder import CalibrationFolder
from rfpipe.calibration.run import calibrate_rig
from rfpipe.cli import app
from rfpipe.config import parse_rig_config
from rfpipe.errors import CaptureError, ConfigError
from rfpipe.report.calibration import build_calibration_report
from rfpipe.rigs.build import rig_from_config
from rfpipe.rigs.calibrated import VERDICTS_KEY, calibration_of, check_verdicts

pytestmark = pytest.mark.slow

RAYS = 12
SETTINGS: dict[str, Any] = {
    "rays": [RAYS, RAYS],
    "projector": {"options": {"settle_seconds": 0.0}},
    "bench": {
        "scene": {
            "kind": "wedge", "surfaces": ["white", "texture"], "shape": [RAYS, RAYS],
            "channels": 1,
        },
        "display_shape": [96, 96],
        "camera_shape": [40, 42],
    },
    "calibrate": {"dark_frames": 3, "levels": 5, "codes": 9, "symmetry_patterns": 4},
}  # fmt: skip


def settings(**changes: Any) -> dict[str, Any]:
    changed = {name: {**SETTINGS.get(name, {}), **value} for name, value in changes.items()}
    return {**SETTINGS, **changed}


def calibrated(
    folder: Path, only: list[str] | None = None, **changes: Any
) -> tuple[dict[str, dict[str, str]], dict[str, Any], str]:
    """Calibrate a bench; return the verdicts, the facts, and the report's text."""
    calibrate_rig(parse_rig_config(settings(**changes), "rig.yaml"), folder, only)
    result = CalibrationFolder(folder)
    page = build_calibration_report(result).read_text(encoding="utf-8")
    verdicts = result.verdicts()
    return verdicts, {name: result.read(name).facts for name in verdicts}, page


UNSEEN = [[[22, 3], [62, 4], [61, 37], [21, 36]]]
"""Corners of the rays on the camera: half of them past its right edge."""


def test_a_healthy_bench_is_good(tmp_path: Path) -> None:
    verdicts, facts, page = calibrated(tmp_path)
    assert {verdict["standing"] for verdict in verdicts.values()} == {"good"}, verdicts
    assert facts["scene"]["saturated_share"] == 0
    assert "#2f7d36" in page  # a green dot
    assert (tmp_path / "figures" / "scene.png").stat().st_size > 5000


@pytest.mark.parametrize("light", [{"ambient": 0.3}, {"projector_black": 0.05}])
def test_room_light_in_dark_pictures_misleads_no_step(
    tmp_path: Path, light: dict[str, float]
) -> None:
    only = ["steadiness", "scene", "dark", "linearity", "light", "transfer"]
    verdicts, facts, _ = calibrated(tmp_path, only, bench=light)
    assert "The all-off picture isn't dark" in verdicts["dark"]["verdict"]
    assert facts["dark"]["hot_photosites"] == 0
    assert verdicts["linearity"]["standing"] == verdicts["light"]["standing"] == "good"
    assert verdicts["transfer"]["standing"] in ("good", "unknown")


def test_a_calibration_that_is_not_good_is_not_served(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = tmp_path / "calibration"
    plain = {**settings(bench={"camera_corners": UNSEEN}), "calibration": str(folder)}
    rig = tmp_path / "rig.yaml"
    rig.write_text(json.dumps(plain))
    done = CliRunner().invoke(app, ["calibrate", str(rig), "--output", str(folder)])
    assert done.exit_code == 1
    assert "Rays of camera and projector: NOT GOOD" in done.output
    result = CalibrationFolder(folder)
    count, total = result.read("rays").facts["unseen_rays"], RAYS**2
    assert 0.3 * total < count < 0.7 * total
    verdicts = result.verdicts()
    assert f"The camera doesn't see {count} of {total} rays" in verdicts["rays"]["verdict"]
    assert "extends beyond the camera's view at the right edge" in verdicts["scene"]["verdict"]
    assert "NOT GOOD" in (folder / "report.html").read_text(encoding="utf-8")
    refused = CliRunner().invoke(app, ["serve", str(rig)], env={"RFPIPE_TOKEN": "x" * 32})
    assert isinstance(refused.exception, ConfigError)
    assert "doesn't see" in str(refused.exception)
    assert "--force" in str(refused.exception)
    config = parse_rig_config(plain, "rig.yaml")
    check_verdicts(calibration_of(config).facts, config.calibration, force=True)
    assert "doesn't see" in caplog.text
    with rig_from_config(config) as served:  # type: ignore[attr-defined]
        assert served.describe()[VERDICTS_KEY]["rays"]["standing"] == "poor"


def test_a_device_that_fails_leaves_a_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text(json.dumps(settings()))
    from rfpipe.devices.bench import PylonBenchCamera

    expose, remaining = PylonBenchCamera.expose, [20]

    def failing(camera: PylonBenchCamera) -> Any:
        remaining[0] -= 1
        if remaining[0] < 0:
            raise CaptureError("the camera is lost")
        return expose(camera)

    monkeypatch.setattr(PylonBenchCamera, "expose", failing)
    folder = tmp_path / "calibration"
    done = CliRunner().invoke(app, ["calibrate", str(rig), "--output", str(folder)])
    assert isinstance(done.exception, CaptureError)
    assert f"report: {folder}/report.html" in done.output
    assert "Verdicts" in (folder / "report.html").read_text(encoding="utf-8")
