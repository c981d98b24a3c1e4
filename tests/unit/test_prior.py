"""Acquisitions that begin with the transport of an earlier one."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from tests.rigs.known_matrix import run as command

from rfpipe import OperatorRig, acquire
from rfpipe.config import CameraConfig
from rfpipe.errors import ConfigError, InputError
from rfpipe.methods.adaptive.prior import pooled_estimate
from rfpipe.methods.error_estimate import Estimate
from rfpipe.methods.held_out import held_out_patterns
from rfpipe.methods.images import Pictures, ScheduledImages
from rfpipe.methods.near_far.prior import denoised_floodlit, without_indirect_light
from rfpipe.provenance import generator
from rfpipe.scenes import reference_scene
from rfpipe.stages.acquire import AcquisitionResult
from rfpipe.stages.plan import Plan
from rfpipe.storage.files import FolderStorage
from rfpipe.store.arrays import open_arrays
from rfpipe.transport import Transport
from rfpipe.transport.dense import DenseTransport

SHAPE = (32, 32)
MATRIX = reference_scene("IV", SHAPE, channels=1).dense().astype(np.float64)


def dense(matrix: np.ndarray, shape: tuple[int, ...] = SHAPE, **row: float) -> DenseTransport:
    rows = [{"level": 0, "patterns": 1, **row}]
    return DenseTransport(shape, shape, 1, rows, {"matrix": matrix[None].astype(np.float32)})


def run(matrix: np.ndarray, method: str, prior: Transport | str | Path | None) -> AcquisitionResult:
    rig = OperatorRig(matrix, SHAPE, SHAPE, CameraConfig())
    return acquire(rig, method, progress=False, prior=prior)


def other_scene() -> np.ndarray:
    """Return a transport of the same rays with twice the indirect light, elsewhere."""
    scene = reference_scene("II", SHAPE, channels=1).dense().astype(np.float64)
    return np.ascontiguousarray(scene[::-1, ::-1])


@pytest.fixture(scope="module")
def first() -> AcquisitionResult:
    return run(MATRIX, "auto", None)


def test_an_unchanged_scene_takes_ten_pictures(first: AcquisitionResult, tmp_path: Path) -> None:
    first.transport.save(tmp_path / "transport.zarr")
    again = run(MATRIX, "auto", tmp_path / "transport.zarr")
    counts = again.picture_counts
    assert (counts.references, counts.symmetry, counts.patterns) == (6, 0, 4)
    assert again.pictures == 10 < first.pictures
    assert again.history["estimated_error"].iloc[-1] <= 0.01
    relit = again.transport.relight_batch(pictures := generator(1).random((9, *SHAPE)) < 0.2)
    truth = (pictures.reshape(9, -1) @ MATRIX.T).reshape(relit.shape)
    assert np.linalg.norm(relit - truth) < 0.01 * np.linalg.norm(truth)


def test_a_useless_prior_costs_no_more_pictures(first: AcquisitionResult) -> None:
    result = run(MATRIX, "near_far", dense(other_scene()))
    assert result.pictures <= first.pictures
    assert result.history["estimated_error"].iloc[-1] <= 0.01
    assert not [part for part in result.transport.parts if isinstance(part, DenseTransport)]


@pytest.mark.parametrize(("limit", "patterns"), [(2, 1), (5, 4), (9, 9)])
def test_a_limit_of_patterns_holds_with_a_prior(limit: int, patterns: int) -> None:
    rig = OperatorRig(MATRIX, SHAPE, SHAPE, CameraConfig())
    options = {"target_error": 1e-3, "patterns": limit, "all_on_brackets": 4}
    result = acquire(rig, "auto", progress=False, prior=dense(0.9 * MATRIX), **options)
    assert result.patterns == patterns


def test_a_refuted_prior_leaves_the_estimate_of_what_is_returned() -> None:
    rig = OperatorRig(MATRIX, SHAPE, SHAPE, CameraConfig())
    result = acquire(rig, "auto", progress=False, prior=dense(other_scene()), patterns=4)
    direct = MATRIX.sum(axis=1)
    pictures = held_out_patterns(SHAPE)[:3].reshape(3, -1)
    errors = np.linalg.norm(pictures * direct - pictures @ MATRIX.T, axis=1)
    errors /= np.linalg.norm(pictures @ MATRIX.T, axis=1)
    assert result.history["estimated_error"].iloc[-1] == pytest.approx(errors.mean(), rel=0.2)


def test_a_prior_of_another_rig_or_for_another_method_is_rejected() -> None:
    with pytest.raises(InputError, match="the same rig"):
        run(MATRIX, "auto", dense(np.eye(16), (4, 4)))
    with pytest.raises(InputError, match="can't begin with a prior"):
        run(MATRIX, "symmetric", dense(MATRIX))
    with pytest.raises(InputError, match="isn't symmetric"):
        run(MATRIX, "near_far", dense(np.triu(MATRIX) + MATRIX[0]))


def test_the_prior_shows_which_method_the_rig_takes() -> None:
    rays = (SHAPE, SHAPE, 1)
    coaxial = Plan.of("auto", "auto", rays, prior=dense(MATRIX))
    aside = Plan.of("auto", "auto", rays, prior=dense(MATRIX[::-1]))
    assert (coaxial.method.name, aside.method.name) == ("near_far", "footprints")
    assert not coaxial.measures_symmetry
    assert Plan.of("auto", "auto", rays).measures_symmetry


@pytest.fixture
def stored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Path of a stored transport between 6 x 8 rays, in a run's folder."""
    monkeypatch.chdir(tmp_path)
    dense(np.eye(48), (6, 8)).save(tmp_path / "before" / "transport.zarr")
    return "before/transport.zarr"


def settings_of(prior: str, method: str = "auto", **scene: object) -> str:
    """Write the settings of a run with a prior; return their path."""
    wedge = {"kind": "wedge", "shape": [6, 8], "channels": 1, **scene}
    methods = {method: {"prior": prior}}
    Path("run.yaml").write_text(json.dumps({"scenes": {"wedge": wedge}, "methods": methods}))
    return "run.yaml"


def test_a_plan_names_the_prior_and_counts_the_pictures_with_it(stored: str) -> None:
    planned = " ".join(command("plan", settings_of(stored)).split())
    assert (
        f"wedge by auto: begins with the prior {stored}; 10 pictures if the scene is unchanged, "
        "about 51 if the prior doesn't help."
    ) in planned
    described = Plan.of("auto", "auto", ((6, 8), (6, 8), 1), {"prior": stored}).describe()
    assert described["expected_patterns"] == 4
    assert described["prior"] == {"path": stored, "digest": open_arrays(Path(stored)).digest}


@pytest.mark.parametrize(
    ("path", "scene", "message"),
    [
        ("missing", {}, "there is no folder of a prior: 'missing'; give the folder transport.zarr"),
        (".", {"channels": 3}, r"the prior is DenseTransport\(.* 1 channel, .*, 3 channels;"),
        (".", {"shape": [8, 6]}, r"but the rig has camera \(8, 6\)"),
        ("results/wedge", {}, "a result of this run, which would replace it; acquire in another"),
        ("empty", {}, "there is no single transport in the folder of the prior: 'empty'"),
    ],
)  # fmt: skip
def test_a_prior_that_cannot_be_used_is_refused_first(
    path: str, scene: dict[str, object], message: str, stored: str
) -> None:
    Path("empty").mkdir()
    dense(np.eye(48), (6, 8)).save(Path("results/wedge/auto/transport.zarr"))
    prior = {".": stored, "results/wedge": "results/wedge/auto"}.get(path, path)
    with pytest.raises(ConfigError, match=message) as caught:
        command("plan", settings_of(prior, **scene))
    assert str(caught.value).startswith("scenes.wedge: methods.auto.prior")


def test_methods_without_a_prior_have_no_such_setting(stored: str) -> None:
    with pytest.raises(ConfigError, match=r"methods\.symmetric\.prior"):
        command("plan", settings_of(stored, "symmetric"))


def test_footprints_end_with_a_prior_that_meets_the_target() -> None:
    aside = MATRIX[::-1]
    result = run(aside, "footprints", dense(aside, estimated_error=0.005))
    assert result.pictures == 10


def test_noise_of_unchanged_pixels_is_that_of_the_prior() -> None:
    floodlit = MATRIX.sum(axis=1)
    light = 1.1 * floodlit
    light[500] *= 1.5
    sigma = 0.01 * floodlit.max()
    noisy = light + sigma * generator(2).standard_normal(light.shape)
    picture = Pictures(
        np.ones((1, light.size), np.bool_),
        noisy[None, None].astype(np.float32),
        np.full((1, 1, light.size), sigma**2, np.float32),
    )
    denoised = denoised_floodlit(picture, dense(MATRIX)).floodlit[0]
    far = np.abs(np.arange(light.size) // 32 - 500 // 32) > 3
    assert np.std((denoised - light)[far]) < 0.5 * sigma
    assert denoised[500] == pytest.approx(light[500], abs=4 * sigma)


def test_a_prior_without_its_indirect_light_leaves_direct_light() -> None:
    lit = generator(3).random((2, MATRIX.shape[1])) < 0.5
    radiance = (lit @ MATRIX.T)[:, None].astype(np.float32)
    pictures = Pictures(lit, radiance, np.ones_like(radiance))
    rest = without_indirect_light(pictures, dense(MATRIX)).radiance[:, 0]
    np.testing.assert_allclose(rest, lit * MATRIX.sum(axis=1), atol=1e-5)


@pytest.mark.parametrize(("own", "expected"), [(0.008, 0.0088), (0.002, 0.0104), (0.0, 0.0104)])
def test_estimates_that_agree_are_pooled(own: float, expected: float) -> None:
    estimate = Estimate(0.0104, 0.0104, 0.0104, 0.1)
    pooled = pooled_estimate(estimate, dense(MATRIX, estimated_error=own))
    assert pooled.error == pytest.approx(expected)


@pytest.mark.parametrize("strength", [0.002, 1.0])
def test_a_state_is_restored_with_its_prior(strength: float, tmp_path: Path) -> None:
    """The weaker change of the scene leaves a useful prior, the stronger one refutes it."""
    change = strength * np.outer(MATRIX[5], MATRIX[5]) / MATRIX[5, 5]
    options = {"target_error": 1e-4, "patterns": 20}
    prior = dense(MATRIX + change + 3 * strength * MATRIX.mean())
    plan = Plan.of("near_far", "near_far", (SHAPE, SHAPE, 1), options, prior=prior)
    state, folder, levels = plan.start(), FolderStorage(tmp_path), 0
    while (schedule := plan.method.next_schedule(state)) is not None:
        light = schedule.batch(0, schedule.count).reshape(schedule.count, -1)
        radiance = (light @ MATRIX.T).reshape(-1, *SHAPE, 1).astype(np.float32)
        images = ScheduledImages(schedule, lambda a, b, c=radiance: (c[a:b], 1e-8 + 0 * c[a:b]))
        before, state = state, plan.method.refine(state, images)
        added = state.to_arrays(before)
        folder.write(levels, "refine", "", added.arrays, {}, state=dict(added.attributes))
        levels += 1
    restored = plan.restored_state(folder, levels)
    assert restored.prior_is_refuted is state.prior_is_refuted is (strength == 1)
    assert state.patterns_shown == 20
    expected = plan.method.transport(state).toarray()
    np.testing.assert_array_equal(plan.method.transport(restored).toarray(), expected)
