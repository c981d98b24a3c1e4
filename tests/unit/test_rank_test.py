"""What the rank test allows noise to do."""

import numpy as np
import pytest

from rfpipe.methods.symmetric.rank_test import Limits

NOTHING_ASKED = Limits(asked=0.0, significance=3.0, tests=1)


def allowed(limits: Limits, noise: float, samples: float, share: float = 1.0) -> float:
    return float(limits.allowed(np.array(noise), np.array(samples), share))


@pytest.mark.parametrize("samples", [50, 200, 1000])
def test_noise_alone_is_within_three_deviations_of_its_mean_square(samples: int) -> None:
    trials, noise = 4000, 2.5
    random = np.random.default_rng(samples)
    squares = random.chisquare(samples, trials) * noise / samples
    beyond = np.mean(squares > allowed(NOTHING_ASKED, noise, samples))
    # 0.13 % of a normal distribution, more of the longer tail of few squares
    assert 0 < beyond < 0.006
    assert allowed(NOTHING_ASKED, noise, samples) == pytest.approx(
        noise * (1 + 3 * np.sqrt(2 / samples))
    )


def test_what_is_asked_for_is_allowed_beyond_the_noise_when_it_is_more_than_noise_may_do() -> None:
    limits = Limits(asked=0.8, significance=3.0, tests=1)
    assert allowed(limits, 1.0, 200) == pytest.approx(1.8)  # chance may add 0.3
    assert allowed(limits, 1.0, 200, 1 / 16) == pytest.approx(1.3)
    assert allowed(limits, 0.0, 200, 1 / 4) == pytest.approx(0.2)


@pytest.mark.parametrize("tests", [1, 100, 100_000])
def test_noise_is_as_seldom_taken_for_light_in_a_level_as_in_one_measurement(tests: int) -> None:
    limits = Limits(asked=0.0, significance=3.0, tests=tests)
    # the tail of n normal deviates beyond t is about n exp(-t^2 / 2)
    assert tests * np.exp(-limits.significant / 2) == pytest.approx(np.exp(-4.5))
