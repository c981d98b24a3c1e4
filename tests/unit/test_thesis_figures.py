"""What the thesis' figures are drawn from and judged by."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from rfpipe.report.figures.claims import verdicts
from rfpipe.report.figures.costs import cost_rows
from rfpipe.report.figures.fits import line_fit, patterns_at
from rfpipe.scenes.mitsuba.views import View
from rfpipe.stages.evaluating.studies.poses import turned
from rfpipe.stages.evaluating.studies.symmetric_pictures import letters


def _studies(**rows: list[dict[str, Any]]) -> Any:
    return {name: SimpleNamespace(rows=own) for name, own in rows.items()}


def test_a_line_is_fitted_to_patterns_that_grow_with_the_levels() -> None:
    levels = np.arange(3, 8)
    numbers = pd.DataFrame({"levels": levels, "rays": 4**levels, "patterns": 7 + 30 * levels})
    fit = line_fit(numbers)
    assert fit["slope"] == pytest.approx(30)
    assert fit["explained"] == pytest.approx(1)
    line, _ = patterns_at(fit, 4**10, (4**7, 7 + 30 * 7))
    assert line == pytest.approx(7 + 30 * 10)


def test_brute_force_has_the_exponent_one() -> None:
    levels = np.arange(3, 8)
    numbers = pd.DataFrame({"levels": levels, "rays": 4**levels, "patterns": 4**levels})
    fit = line_fit(numbers)
    assert fit["exponent"] == pytest.approx(1)
    assert fit["explained"] < 0.9
    _, power = patterns_at(fit, 4**9, (4**7, 4**7))
    assert power == pytest.approx(4**9)


@pytest.mark.parametrize(
    ("pixel", "hierarchy", "verdict"),
    [(0.01, 0.98, "holds"), (0.7, 0.95, "in part"), (0.9, 0.5, "does not")],
)
def test_a_claim_is_judged_by_what_was_measured(
    pixel: float, hierarchy: float, verdict: str
) -> None:
    rows = [
        {"case": "pixel", "kept": pixel, "error": 0.5},
        {"case": "hierarchy", "kept": hierarchy, "error": 0.02},
    ]
    first, second = verdicts(_studies(box=rows))
    assert (first.figure, first.verdict) == ("Fig. 3.3", verdict)
    assert (second.figure, second.verdict) == ("Fig. 3.4", "holds")


def test_measured_costs_have_no_extrapolation_without_a_fit() -> None:
    row = {
        "table": "3.1",
        "figure": "Fig. 3.4, box",
        "world": "two_blocks",
        "camera_rays": 64,
        "rays": 25,
        "patterns": 20,
        "megabytes": 1.0,
        "processing_s": 6.0,
        "error": 0.1,
    }
    levels = np.arange(3, 6)
    grown = [
        {"scene": "box", "levels": int(n), "rays": int(4**n), "patterns": int(10 * n)}
        for n in levels
    ]
    (alone,) = cost_rows(SimpleNamespace(studies=_studies(box=[row])))  # type: ignore[arg-type]
    assert alone["extrapolated"] is None
    assert alone["brute_force_days"] == pytest.approx(1 / (60 * 24))
    assert alone["minutes"] == pytest.approx(20 / 25 + 0.1)
    both = _studies(box=[row], growth=grown)
    (fitted,) = cost_rows(SimpleNamespace(studies=both))  # type: ignore[arg-type]
    assert fitted["patterns"] == 20
    assert fitted["extrapolated"] == pytest.approx(20 + 10 * np.log2(512 * 512 / 25) / 2)


def test_a_view_turned_keeps_its_distance_and_goes_right_and_up() -> None:
    view = View((0, 0, 4), (0, 0, 0))
    origin = np.array(turned(view, 30, 20)["origin"])
    assert np.linalg.norm(origin) == pytest.approx(4)
    assert origin[0] > 0
    assert origin[1] == pytest.approx(4 * np.sin(np.radians(20)))


@pytest.mark.parametrize("side", [8, 16, 48, 64])
def test_letters_fit_into_any_picture(side: int) -> None:
    picture = letters(side)
    assert picture.shape == (side, side)
    assert 0.02 < picture.mean() < 0.4
