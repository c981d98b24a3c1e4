"""What the thesis' figures are drawn from and judged by."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.ndimage import uniform_filter

from rfpipe.report.figures.claims import verdicts
from rfpipe.report.figures.claims_of_runs import _detail
from rfpipe.report.figures.costs import cost_rows
from rfpipe.report.figures.fits import line_fit, patterns_at
from rfpipe.stages.evaluating.studies.poses import turned
from rfpipe.stages.evaluating.studies.symmetric_pictures import letters
from rfpipe_mitsuba.views import View


def _inputs(**rows: list[dict[str, Any]]) -> Any:
    """Return inputs of a report that have studies alone."""
    studies = {name: SimpleNamespace(rows=own) for name, own in rows.items()}
    return SimpleNamespace(studies=studies, runs=[], methods=[], config=SimpleNamespace(scenes={}))


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
    first, second = verdicts(_inputs(box=rows))
    assert (first.figure, first.verdict) == ("Fig. 3.3", verdict)
    assert (second.figure, second.verdict) == ("Fig. 3.4", "holds")


def _grown(patterns: list[int]) -> list[dict[str, Any]]:
    levels = range(3, 3 + len(patterns))
    return [
        {"scene": "box", "side": 2 ** (n - 1), "rays": 4 ** (n - 1), "levels": n,
         "patterns": count, "blocks": (4**n - 1) // 3}
        for n, count in zip(levels, patterns, strict=True)
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("patterns", "verdict"),
    [
        ([21, 61, 101, 141, 181], "holds"),  # 40 a level
        ([21, 85, 301, 849, 1209], "in part"),  # no line, but slowing down
        ([21, 85, 341, 1365, 5461], "does not"),  # brute force
    ],
)
def test_growth_is_logarithmic_where_each_level_takes_as_many_patterns(
    patterns: list[int], verdict: str
) -> None:
    (found,) = verdicts(_inputs(growth=_grown(patterns)))
    assert (found.figure, found.verdict) == ("Fig. 3.8", verdict)


@pytest.mark.parametrize(
    ("error", "moves", "verdict"),
    [(0.02, 0.3, "holds"), (0.1, 0.3, "in part"), (0.1, 0.05, "does not")],
)
def test_a_light_field_has_to_show_more_change_than_error(
    error: float, moves: float, verdict: str
) -> None:
    row = {
        "errors": [[error, 0.01], [0.01, error]],
        "matte_error": 0.01,
        "light_moves": moves,
        "view_moves": 0.5,
    }
    (found,) = verdicts(_inputs(views=[row]))
    assert (found.figure, found.verdict) == ("Fig. 5.8", verdict)


@pytest.mark.parametrize(
    ("energy", "restored", "verdict"),
    [(0.9, 0.001, "in part"), (1.0, 0.001, "does not"), (0.9, 0.5, "does not")],
)
def test_normalization_is_judged_for_either_chain(
    energy: float, restored: float, verdict: str
) -> None:
    rows = [
        {"chain": chain, "normalization": mode, "energy": light, "colour_contrast": light,
         "rms": rms}
        for chain, light in (("linear", 1.0), ("median", energy))
        for mode, rms in (("none", 0.5), ("per_channel", restored))
    ]  # fmt: skip
    (found,) = verdicts(_inputs(mosaic=rows))
    assert (found.figure, found.verdict) == ("Fig. B.1", verdict)


@pytest.mark.parametrize(
    ("patterns", "verdict"), [(50, "holds"), (900, "in part"), (9000, "does not")]
)
def test_costs_are_judged_by_orders_of_magnitude(patterns: int, verdict: str) -> None:
    row = {
        "figure": "Fig. 5.6, gummy bears", "table": "5.1", "world": "sweets", "rays": 10_000,
        "camera_rays": 10_000, "patterns": patterns, "megabytes": 1.0, "processing_s": 1.0,
    }  # fmt: skip
    (found,) = verdicts(_inputs(other=[row]))
    assert (found.figure, found.verdict) == ("Table 5.1", verdict)


@pytest.mark.parametrize(
    ("loose", "without", "verdict"),
    [(0.01, 0.01, "holds"), (0.01, 0.03, "in part"), (0.03, 0.03, "does not")],
)
def test_flare_corrupts_only_what_is_worse_than_without_it(
    loose: float, without: float, verdict: str
) -> None:
    errors = {"tight": 0.03, "loose": loose, "without": without}
    rows = [{"case": case, "around": error} for case, error in errors.items()]
    (found,) = verdicts(_inputs(flare=rows))
    assert (found.figure, found.verdict) == ("Fig. 5.11", verdict)


def test_fine_detail_is_kept_by_the_same_picture_and_lost_by_a_blurred_one() -> None:
    picture = np.random.default_rng(0).random((20, 30, 3))
    blurred = uniform_filter(picture, (7, 7, 1))
    where = np.ones((20, 30), bool)
    assert _detail(picture, picture, where) == pytest.approx(1)
    assert _detail(blurred, picture, where) < 0.2


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
    (alone,) = cost_rows(_inputs(box=[row]))
    assert alone["extrapolated"] is None
    assert alone["brute_force_days"] == pytest.approx(1 / (60 * 24))
    assert alone["minutes"] == pytest.approx(20 / 25 + 0.1)
    (fitted,) = cost_rows(_inputs(box=[row], growth=grown))
    assert fitted["patterns"] == 20
    assert fitted["extrapolated"] == pytest.approx(20 + 10 * np.log2(512 * 512 / 25) / 2)


@pytest.mark.parametrize("positions", [1, 5, 160])
def test_a_field_is_extrapolated_to_the_positions_of_the_thesis(positions: int) -> None:
    row = {
        "table": "3.1", "figure": "Fig. 3.9, 80 positions", "world": "still_life_arc",
        "camera_rays": 64, "rays": 25, "patterns": 20 * positions, "megabytes": 1.0,
        "processing_s": 6.0, "error": 0.1, "positions": positions,
    }  # fmt: skip
    grown = [{"scene": "box", "levels": n, "rays": 4**n, "patterns": 10 * n} for n in (3, 4, 5)]
    (found,) = cost_rows(_inputs(arc=[row], growth=grown))
    assert found["extrapolated"] == pytest.approx(80 * (20 + 10 * np.log2(162_900 / 25) / 2))
    assert found["scan"] == 25 * positions
    assert f"{positions} positions" in found["ours"]


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
