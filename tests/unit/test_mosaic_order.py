"""Detection of the order of a mosaic's colours."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from tests.rigs.calibration_bench import CAMERA, wedge_bench

from rfpipe.calibration.context import StepContext
from rfpipe.calibration.mosaic import ORDERS, mosaic_of
from rfpipe.calibration.steps import STEPS
from rfpipe.calibration.verdicts import Findings
from rfpipe.config import CalibrationConfig
from rfpipe.photometry.demosaic import mosaic
from rfpipe.testing import faults

TINT = np.array([0.6, 1.0, 0.45])
"""Counts of red, green and blue photosites in white light."""


def pictures(order: str, tint: np.ndarray = TINT, noise: float = 0.01) -> tuple:
    """Return white, red, green and blue pictures of a textured scene through a mosaic."""
    random = np.random.default_rng(0)
    albedo = random.uniform(0.2, 1, (12, 15)).repeat(4, axis=0).repeat(4, axis=1)
    falloff = np.linspace(0.6, 1, albedo.shape[1])
    scene = 1000 * (albedo * falloff)[..., None] * tint
    crossed = 0.85 * np.eye(3) + 0.05  # filters transmit a part of the other colours
    images = [scene * crossed[colour] for colour in range(3)]
    light = np.stack([mosaic(image.astype(np.float32), order) for image in (sum(images), *images)])
    light = light * (1 + noise * random.standard_normal(light.shape))
    return light[0].astype(np.float64), light[1:].astype(np.float64)


@pytest.mark.parametrize("order", ORDERS)
def test_coloured_pictures_find_the_order(order: str) -> None:
    for tint in (TINT, np.ones(3), np.array([0.2, 1, 1])):
        assert mosaic_of(*pictures(order, tint)).orders == (order,)


@pytest.mark.parametrize("order", ORDERS)
def test_green_pixels_leave_two_possible_orders(order: str) -> None:
    orders = mosaic_of(pictures(order)[0], None).orders
    assert order in orders
    assert len(orders) == 2
    assert {candidate[0] in "RB" for candidate in orders} == {order[0] in "RB"}


def test_an_order_that_the_light_does_not_reveal_is_unknown() -> None:
    grey = np.ones(3)
    assert mosaic_of(pictures("RGGB", grey)[0], None).orders == ORDERS
    white, _ = pictures("RGGB")
    assert mosaic_of(np.full_like(white, np.nan), None).orders == ORDERS
    assert mosaic_of(white[:4, :4], None).orders == ORDERS


def scene_of(stated: str, true: str, *, has_colours: bool) -> Findings:
    """Run the step `scene` for a camera whose settings state a wrong order."""
    bench = wedge_bench(
        (12, 12), (96, 96), (48, 54), channels=3, sensor=replace(CAMERA, bayer=true)
    )
    tinted = bench.camera._radiance
    bench.camera._radiance = lambda: tinted() * TINT.astype(np.float32)  # type: ignore[method-assign]
    camera = faults.MisreadMosaic(bench.camera, stated)
    projector = bench.projector
    if not has_colours:
        projector.show_colour = None  # type: ignore[assignment,method-assign]
    context = StepContext(projector, camera, CalibrationConfig(), None, {}, lambda _: nullcontext())
    return STEPS["scene"].measure(context)


@pytest.mark.slow
@pytest.mark.parametrize("stated", ORDERS)
def test_a_wrong_order_is_not_good_and_the_correct_one_is_named(stated: str) -> None:
    verdict = scene_of(stated, "RGGB", has_colours=True).verdict
    if stated == "RGGB":
        assert verdict.standing == "good"
        return
    assert verdict.standing == "poor"
    assert f"sensor.bayer, {stated}" in verdict.text
    assert "Set sensor.bayer to RGGB" in verdict.text


@pytest.mark.slow
def test_without_coloured_light_two_orders_are_possible() -> None:
    assert (
        "Set sensor.bayer to RGGB or BGGR"
        in scene_of("GRBG", "RGGB", has_colours=False).verdict.text
    )
    assert scene_of("RGGB", "RGGB", has_colours=False).verdict.standing == "good"
