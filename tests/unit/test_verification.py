"""Errors of transports in verification pictures, and their comparison with targets."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest
from tests.rigs.displaced_rigs import DIM, SHAPE, beside, wedge
from tests.rigs.known_matrix import settings_of_a_plane

import rfpipe
from rfpipe.config import parse_config
from rfpipe.errors import ConfigError, InputError, VerificationError
from rfpipe.photometry import CameraModel
from rfpipe.photometry.camera import UNKNOWN_DEVIATION
from rfpipe.provenance import generator
from rfpipe.stages.verification import Verification, check_bounds, compare_with_captured

FEW = {"all_on_brackets": 32, "progress": False, "symmetry_brackets": 0}


@pytest.mark.parametrize("camera", [None, CameraModel(), DIM])
@pytest.mark.parametrize("method", ["symmetric", "dual"])
@pytest.mark.parametrize("pixels", [0.0, 0.5])
def test_the_error_is_the_true_error_within_noise(
    method: str, pixels: float, camera: CameraModel | None
) -> None:
    matrices = beside(wedge(), pixels)
    rig = rfpipe.OperatorRig(list(matrices), SHAPE, SHAPE, camera)
    result = rfpipe.acquire(rig, method, tolerance=1e-2, verification=9, **FEW)
    verification = result.verification
    assert verification is not None
    assert list(verification.table["name"])[:4] == ["shapes 1", "bars 1", "spots 1", "shapes 2"]
    truth = np.einsum("cmn,pn->pmc", matrices, verification.patterns.reshape(9, -1))
    floodlit = np.einsum("cmn->mc", matrices)
    relit = verification.relit.reshape(truth.shape)
    true, _ = rfpipe.picture_errors(relit, truth, verification.patterns, floodlit)
    for row, expected in zip(verification.table.itertuples(), true, strict=True):
        # the black level and the lamp's gain are noisy, but equal for all pictures
        assert abs(row.error - expected) < 4 * row.standard_error + 2e-3, row.name
    assert verification.mean_error == pytest.approx(true.mean(), abs=2e-3)
    if method == "symmetric" and pixels:
        assert verification.mean_error > 0.3  # the transport alone has no sign of this


def test_noise_alone_is_no_error() -> None:
    random = generator(1)
    truth = random.random((200, 6, 7, 1)).astype(np.float32)
    variance = (0.001 + 0.01 * truth).astype(np.float32)
    captured = (truth + np.sqrt(variance) * random.standard_normal(truth.shape)).astype(np.float32)
    variance[:, 0, :3] = np.inf
    captured[:, 0, :3], captured[:, 0, 3:] = 1e6, np.nan  # unknown pixels don't count
    floodlit = np.zeros((2, 6, 7, 1), np.float32)
    floodlit[0, 0, 3:] = np.nan
    verification = compare_with_captured(
        truth[..., 0], (captured, variance), truth, np.ones(1), floodlit
    )
    errors, spread = verification.table["error"], verification.table["standard_error"]
    assert (errors == 0).mean() == pytest.approx(0.5, abs=0.15)
    assert (errors > 3 * spread).mean() < 0.02
    relit = truth * np.float32(1.2)
    off = compare_with_captured(truth[..., 0], (captured, variance), relit, np.ones(1), floodlit)
    errors, spread = off.table["error"], off.table["standard_error"]
    assert errors.mean() == pytest.approx(0.2, rel=0.02)
    assert np.std((errors - 0.2) / spread) == pytest.approx(1, abs=0.2)


def test_a_saturated_glint_does_not_reduce_the_error() -> None:
    """Saturated samples have a larger uncertainty than any error of the other samples."""
    truth = generator(1).random((3, 6, 7, 1)).astype(np.float32)
    variance = np.full_like(truth, 1e-6)
    truth[:2, 2, 3] = 2
    variance[:2, 2, 3] = (UNKNOWN_DEVIATION * 2) ** 2
    floodlit = np.zeros((2, 6, 7, 1), np.float32)
    relit = truth * np.float32(1.02)
    verification = compare_with_captured(
        truth[..., 0], (truth, variance), relit, np.ones(1), floodlit
    )
    assert verification.mean_error == pytest.approx(0.02, rel=0.2)


def test_the_error_of_a_dark_picture_is_relative_to_a_typical_one() -> None:
    pattern, dark = np.zeros((1, 4, 4), np.float32), np.zeros((1, 4, 4, 1), np.float32)
    pattern[0, 0, 0] = 1  # the spot lights a black surface
    white = np.ones((4, 4, 1), np.float32), np.full((4, 4, 1), 0.25, np.float32)
    relit = dark.copy()
    relit[0, 0, 0] = 0.1
    verification = compare_with_captured(pattern, (dark, dark), relit, np.ones(1), white)
    # half of sqrt(16 (1 - 0.25) / 16): without the floodlit image's own noise
    assert verification.mean_error == pytest.approx(0.1 / (0.5 * np.sqrt(0.75)))


def test_without_light_there_is_no_error() -> None:
    nothing = np.zeros((1, 3, 4, 1), np.float32)
    dark = nothing, nothing
    verification = compare_with_captured(
        nothing[..., 0], dark, nothing, np.ones(1), (nothing[0], nothing[0])
    )
    assert np.isnan(verification.mean_error)
    assert json.loads(json.dumps(verification.facts()))["mean_error"] is None


def test_acquisitions_above_their_bound_are_named() -> None:
    facts = {"mean_error": 0.03, "worst_error": 0.06, "worst_picture": "spots", "noise": 0.004}
    dark = {"mean_error": None, "worst_error": None, "worst_picture": "spots", "noise": None}
    rows = [{"level": level, "patterns": 9, "estimated_error": 0.04 / level} for level in (1, 2)]
    manifests = {"vase": facts, "jug": dark, "cup": {"levels": rows}, "pot": {"levels": []}}
    check_bounds(manifests, {"vase": 0.05, "cup": 0.03, "pot": 0.01}, "report")
    for bounds, expected in (
        ({"vase": 0.02}, r"vase has a mean error of 3.00%.*above 2.00%.*'spots'"),
        ({"jug": 0.05}, "jug has no picture with light"),
        ({"cup": 0.01}, r"cup has an estimated error of 2.00%, above 1.00%"),
    ):
        with pytest.raises(VerificationError, match=expected):
            check_bounds(manifests, bounds, "report")


def test_a_real_rig_s_bound_follows_the_target_error() -> None:
    vase = {"kind": "captured", "shape": [8, 8]}
    methods = {"dual": {}, "footprints": {"target_error": 0.02}}
    run = {"scenes": {"vase": vase}, "methods": methods, "capture": {"rig": "remote"}}
    bounds = {"dual": None, "footprints": 0.03}
    for change, expected in (
        ({}, bounds),
        ({"verification": {"fail_above": 0.2}}, {"dual": 0.2, "footprints": 0.2}),
        ({"verification": {"pictures": 0}}, {"dual": None, "footprints": 0.02}),
        ({"capture": {"rig": "offline"}}, bounds),
    ):
        config = parse_config({**run, **change}, "c")
        assert {name: config.bound_of("vase", name) for name in bounds} == expected
    simulated = settings_of_a_plane(methods={"auto": {}})
    assert simulated.bound_of("plane", "auto") is None


@pytest.mark.parametrize(
    ("error", "target", "verdict"),
    [
        (0.01, 0.02, "met"),
        (0.05, 0.02, "missed"),
        (0.021, 0.02, "unsure"),
        (0.05, None, "unknown"),
        (np.nan, 0.02, "unknown"),
    ],
)
def test_a_target_is_met_or_missed(error: float, target: float | None, verdict: str) -> None:
    rows = [["shapes 1", error, 0, error * factor, 0.001] for factor in (0.8, 1, 1.2)]
    columns = ["name", "difference", "noise", "error", "standard_error"]
    nothing = np.zeros((3, 2, 2, 1), np.float32)
    table = pd.DataFrame(rows, columns=columns)
    verification = Verification(table, nothing[..., 0], nothing, nothing, np.ones(1)).against(
        target
    )
    assert verification.verdict == verdict
    if target is not None and np.isfinite(error):
        assert f"{target:.2%}" in verification.reason


def test_a_negative_number_of_pictures_is_refused() -> None:
    with pytest.raises(InputError, match="verification is -1"):
        rfpipe.acquire(rfpipe.OperatorRig(np.eye(4), (2, 2), (2, 2)), verification=-1)


def test_real_rigs_are_verified_by_default() -> None:
    captured = {"scenes": {"vase": {"kind": "captured", "shape": [8, 8]}}, "methods": {"dual": {}}}
    assert settings_of_a_plane().verification_pictures == 0
    assert parse_config({**captured, "capture": {"rig": "remote"}}, "c").verification_pictures == 9
    offline = {**captured, "capture": {"rig": "offline"}}
    assert parse_config(offline, "c").verification_pictures == 3
    settings = {**offline, "verification": {"pictures": 5}}
    assert parse_config(settings, "c").verification_pictures == 5
    with pytest.raises(ConfigError, match=r"verification.pictures should be 1 to 96"):
        settings_of_a_plane(verification={"fail_above": 0.1})
