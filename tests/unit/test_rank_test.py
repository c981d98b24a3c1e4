"""Thresholds of the rank test and their distribution under noise."""

import numpy as np
import pytest

from rfpipe.methods.symmetric.rank_test import Thresholds

NOISE_ONLY = Thresholds(allowed_square=0.0, significance=3.0, tests=1)


def allowed(limits: Thresholds, noise: float, samples: float, share: float = 1.0) -> float:
    return float(limits.allowed(np.array(noise), np.array(samples), share))


@pytest.mark.parametrize("samples", [50, 200, 1000])
def test_noise_alone_is_within_three_deviations_of_its_mean_square(samples: int) -> None:
    trials, noise = 4000, 2.5
    random = np.random.default_rng(samples)
    squares = random.chisquare(samples, trials) * noise / samples
    beyond = np.mean(squares > allowed(NOISE_ONLY, noise, samples))
    # 0.13 % of a normal distribution, more of the longer tail of few squares
    assert 0 < beyond < 0.006
    assert allowed(NOISE_ONLY, noise, samples) == pytest.approx(
        noise * (1 + 3 * np.sqrt(2 / samples))
    )


def test_the_larger_of_tolerance_and_fluctuation_is_added_to_the_noise() -> None:
    limits = Thresholds(allowed_square=0.8, significance=3.0, tests=1)
    assert allowed(limits, 1.0, 200) == pytest.approx(1.8)  # the fluctuation is 0.3
    assert allowed(limits, 1.0, 200, 1 / 16) == pytest.approx(1.3)
    assert allowed(limits, 0.0, 200, 1 / 4) == pytest.approx(0.2)


@pytest.mark.parametrize("tests", [1, 100, 100_000])
def test_the_probability_of_accepting_noise_does_not_depend_on_the_number_of_tests(
    tests: int,
) -> None:
    limits = Thresholds(allowed_square=0.0, significance=3.0, tests=tests)
    # the tail of n normal deviates beyond t is about n exp(-t^2 / 2)
    assert tests * np.exp(-limits.squared_level_significance / 2) == pytest.approx(np.exp(-4.5))
