"""Number of reference brackets: it follows from the target, the light and the scene."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from tests.rigs.displaced_rigs import SHAPE, wedge
from tests.workflow.stagewise import SETTINGS
from tests.workflow.stagewise import acquire as acquire_on_files

import rfpipe
from rfpipe.photometry import CameraModel
from rfpipe.references.reference_brackets import (
    FIRST_ALL_OFF,
    FIRST_ALL_ON,
    MOST_ALL_OFF,
    MOST_ALL_ON,
    ReferenceCounts,
    ReferenceNoise,
    open_reference_brackets,
    reference_counts,
)
from rfpipe.stages.plan import Plan

FIRST = ReferenceCounts(FIRST_ALL_OFF, FIRST_ALL_ON)


def rig(electrons: float) -> rfpipe.OperatorRig:
    return rfpipe.OperatorRig(
        list(wedge()), SHAPE, SHAPE, CameraModel(electrons_per_radiance=electrons)
    )


def counts_on_files(folder: Path, electrons: float) -> ReferenceCounts:
    plan = Plan.of("near_far", "near_far", (SHAPE, SHAPE, 1), {"target_error": 0.04})
    chosen = replace(
        SETTINGS, all_off_brackets=None, all_on_brackets=None, target_error=plan.target_error,
        expected_patterns=plan.expected_patterns,
    )  # fmt: skip
    stored = acquire_on_files(folder, rig(electrons), plan, chosen)
    with open_reference_brackets(stored) as brackets:
        all_off, all_on = list(brackets.all_off), list(brackets.all_on)
    counts = reference_counts(stored.read_manifest(0, "capture"))
    assert (len(all_off), len(all_on)) == counts
    assert max(map(np.mean, all_off)) < min(map(np.mean, all_on))
    assert all(np.any(one != other) for one, other in pairwise(all_on))
    return counts


@pytest.mark.parametrize(
    ("noise", "target", "patterns", "expected"),
    [
        (0.0, 0.01, 30, FIRST),
        (0.0025, 0.01, 30, ReferenceCounts(2, 4)),  # r = 1/16, n = 1.97
        (0.005, 0.01, 60, ReferenceCounts(6, 6)),  # r = 1/4, n = 5.6
        (0.02, 0.01, 30, ReferenceCounts(8, 18)),  # r = 4, n = 17.6
        (0.005, 0.01, 2000, ReferenceCounts(8, 32)),  # many patterns are worth more brackets
        (np.inf, 0.01, 30, ReferenceCounts(MOST_ALL_OFF, MOST_ALL_ON)),
    ],
)
def test_one_more_bracket_is_worth_one_more_pattern(
    noise: float, target: float, patterns: int, expected: ReferenceCounts
) -> None:
    assert ReferenceNoise(noise, noise).needed(target, patterns) == expected


def test_the_predicted_noise_is_that_of_the_brackets() -> None:
    dim = rig(3000.0)
    patterns = np.ones((40, *SHAPE), np.float32)
    all_off = dim.capture(0 * patterns, [(1, index) for index in range(40)])
    all_on = dim.capture(patterns, [(2, index) for index in range(40)])
    noise = ReferenceNoise.of(dim.sensor, all_off, all_on)
    merge = dim.sensor.bracket_merge(all_off.mean(axis=0, dtype=np.float64).astype(np.float32), 40)
    images = merge(all_on).radiance.astype(np.float64)
    norm = np.linalg.norm(images.mean(axis=0))
    assert np.sqrt(images.var(axis=0, ddof=1).sum()) / norm == pytest.approx(noise.all_on, rel=0.1)
    dark = merge(all_off).radiance.astype(np.float64)
    assert np.sqrt(dark.var(axis=0, ddof=1).sum()) / norm == pytest.approx(noise.all_off, rel=0.1)


def test_less_light_takes_more_brackets_up_to_a_limit(tmp_path: Path) -> None:
    counts = [
        counts_on_files(tmp_path / str(electrons), electrons) for electrons in (3e5, 150.0, 10.0)
    ]
    assert counts[0] == FIRST
    assert FIRST_ALL_ON < counts[1].all_on < MOST_ALL_ON
    assert counts[2].all_on == MOST_ALL_ON


def test_a_given_number_of_brackets_is_taken(tmp_path: Path) -> None:
    plan = Plan.of("dual", "dual", (SHAPE, SHAPE, 1), {})
    chosen = replace(SETTINGS, all_off_brackets=3, all_on_brackets=7)
    stored = acquire_on_files(tmp_path, rig(200.0), plan, chosen)
    assert reference_counts(stored.read_manifest(0, "capture")) == (3, 7)
