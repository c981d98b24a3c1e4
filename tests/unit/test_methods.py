"""The contract of acquisition methods, run on all methods of rfpipe."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rfpipe.blocks import RayDomain
from rfpipe.errors import InputError
from rfpipe.methods import Method, get_method, method_names, options_of
from rfpipe.methods.auto import Auto
from rfpipe.methods.brute_force import BruteForce
from rfpipe.methods.dual import Dual
from rfpipe.methods.footprints.method import Footprints
from rfpipe.methods.hadamard import Hadamard
from rfpipe.methods.multiplexed.method import Multiplexed
from rfpipe.methods.near_far.method import NearFar
from rfpipe.methods.symmetric.method import Symmetric
from rfpipe.testing import MethodContract

NAMES = method_names()


class TestBruteForce(MethodContract):
    error = floodlit_error = 1e-6

    def make_method(self) -> Method:
        return BruteForce()


class TestHadamard(MethodContract):
    error = floodlit_error = 1e-5

    def make_method(self) -> Method:
        return Hadamard()


class TestDual(MethodContract):
    options = {"tolerance": 1e-4}  # noqa: RUF012

    def make_method(self) -> Method:
        return Dual()


class TestMultiplexed(MethodContract):
    def make_method(self) -> Method:
        return Multiplexed()


class TestSymmetric(MethodContract):
    options = {"tolerance": 1e-4}  # noqa: RUF012
    error = floodlit_error = 1e-3

    def make_method(self) -> Method:
        return Symmetric()


class TestAuto(MethodContract):
    options = {"target_error": 1e-3}  # noqa: RUF012
    error = 0.03

    def make_method(self) -> Method:
        return Auto()


class TestFootprints(MethodContract):
    options = {"target_error": 0.001}  # noqa: RUF012
    error = 0.03

    def make_method(self) -> Method:
        return Footprints()


class TestNearFar(MethodContract):
    options = {"target_error": 1e-3}  # noqa: RUF012

    def make_method(self) -> Method:
        return NearFar()


class Broken(BruteForce):
    """Brute force with a changed matrix."""

    def __init__(self, change: Any) -> None:
        self.change = change

    def transport(self, state: Any) -> Any:
        return super().transport(replace(state, matrix=self.change(state.matrix)))


@pytest.mark.parametrize(
    ("change", "test", "message"),
    [
        (lambda matrix: matrix[::-1], "a_small_matrix_is_estimated", "channel 0"),
        (
            lambda matrix: matrix * (np.arange(30) % 6 < 5),
            "a_small_matrix_is_estimated",
            "column 5",
        ),
        (lambda matrix: 3 * matrix, "light_is_finite_and_bounded", "of light became"),
    ],
)
def test_the_contract_detects_violations(change: Any, test: str, message: str) -> None:
    suite: Any = MethodContract()
    suite.floodlit_error, suite.make_method = 1.0, lambda: Broken(change)
    with pytest.raises(AssertionError, match=message):
        getattr(suite, f"test_{test}")()


def test_every_installed_method_is_tested_here() -> None:
    suites = MethodContract.__subclasses__()
    assert {suite().make_method().name for suite in suites} >= set(NAMES)


def test_methods_differ_in_title_colour_and_marker() -> None:
    methods = [get_method(name) for name in NAMES]
    assert [method.name for method in methods] == list(NAMES)
    assert len({method.title for method in methods}) == len(NAMES) == 8
    assert len({method.colour for method in methods}) == len(NAMES)
    assert len({method.marker for method in methods}) == len(NAMES)


def test_unknown_names_and_other_objects_than_methods_are_refused() -> None:
    with pytest.raises(InputError, match=r"'duel' is unknown; did you mean dual\? Expected one of"):
        get_method("duel")
    with pytest.raises(InputError, match=r"derived from rfpipe\.methods\.Method"):
        get_method("rfpipe.blocks:RayDomain")
    with pytest.raises(InputError, match=r"rfpipe\.blocks has no 'Nothing'"):
        get_method("rfpipe.blocks:Nothing")
    with pytest.raises(InputError, match=r"there is no module 'rfpipe\.nowhere'"):
        get_method("rfpipe.nowhere:Method")


@pytest.mark.parametrize(
    ("name", "options", "patterns"),
    [
        ("near_far", {"patterns": 30}, 30),
        ("hadamard", {}, 4363),
        ("brute_force", {}, 4340),
    ],
)
def test_the_forecast_of_a_method_respects_a_limit_of_patterns(
    name: str, options: dict[str, int], patterns: int
) -> None:
    method, rays = get_method(name), RayDomain((62, 70))
    assert method.forecast(rays, rays, 1, options_of(method, **options)).patterns == patterns
