"""Export of matrices, relit pictures and movies, in Python and by commands."""

import sys
from pathlib import Path

import av
import numpy as np
import pytest
from numpy.typing import NDArray
from tests.rigs.known_matrix import run

from rfpipe.errors import InputError, RfpipeError, StoreError
from rfpipe.export import (
    moving_light,
    rays_at,
    relit_movie,
    relit_pictures,
    write_movie,
)
from rfpipe.pictures.images import read_image, srgb, write_image
from rfpipe.scenes.relighting import relighting_patterns
from rfpipe.transport import coarser
from rfpipe.transport.dense import DenseTransport

CAMERA, PROJECTOR, VIEWS = (6, 8), (5, 7), (2, 4, 6)
RANDOM = np.random.default_rng(3)


def transport_of(camera: tuple[int, ...] = CAMERA, projector: tuple[int, ...] = PROJECTOR):
    shape = 3, int(np.prod(camera)), int(np.prod(projector))
    matrix = np.random.default_rng(1).random(shape, dtype=np.float32)
    return DenseTransport(camera, projector, 3, [], {"matrix": matrix})


@pytest.fixture
def stored(tmp_path: Path) -> Path:
    transport_of().save(tmp_path / "transport.zarr")
    return tmp_path / "transport.zarr"


def refused(*arguments: object) -> str:
    with pytest.raises(RfpipeError) as caught:
        run(*arguments)
    return str(caught.value)


def relit(stored: Path, folder: Path, *patterns: object, options=(), by=run) -> str:
    named = [part for pattern in patterns for part in ("--pattern", pattern)]
    return by("relight", stored, *named, "-o", folder, *options)


def frames_of(path: Path) -> NDArray[np.uint8]:
    with av.open(str(path)) as container:
        return np.stack([frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)])


# --- selection of rays


@pytest.mark.parametrize(
    ("text", "shape", "expected"),
    [
        ("2,3", CAMERA, [19]),
        ("1:3,6:", CAMERA, [14, 15, 22, 23]),
        ("::4,::4", CAMERA, [0, 4, 32, 36]),
        ("1,0,5", VIEWS, [29]),
    ],
)
def test_rays_are_selected_by_numpy_like_indices(text: str, shape, expected) -> None:
    assert rays_at(text, shape).tolist() == list(expected)


@pytest.mark.parametrize(
    ("text", "shape", "message"),
    [
        ("2,3", VIEWS, "expected view,row,column"),
        ("6,0", CAMERA, "outside the rays"),
        ("2,x", CAMERA, "'x' is neither a number nor a slice"),
        ("4:4,0", CAMERA, "no ray of"),
    ],
)
def test_other_texts_for_rays_are_refused(text: str, shape, message: str) -> None:
    with pytest.raises(InputError, match=message):
        rays_at(text, shape)


# --- light paths


@pytest.mark.parametrize(("path", "axis"), [("across", 0), ("down", 1), ("circle", None)])
def test_paths_move_a_light_within_the_weights(path: str, axis: int | None) -> None:
    first, middle, last = (moving_light(path, (20, 30), time) for time in (0, 0.5, 1))
    assert middle.min() >= 0
    assert middle.max() <= 1
    if axis is not None:  # the bar is in the middle at half time, and outside at both ends
        lit = np.flatnonzero(middle.any(axis=axis))
        assert abs(lit.mean() - (middle.shape[1 - axis] - 1) / 2) < 0.6
        assert middle.sum(axis=1 - axis).std() < 1e-6
        assert first.max() <= 0.5 >= last.max()
        assert middle.sum() == pytest.approx(2.5 * middle.shape[axis], rel=0.05)
    else:
        assert middle.sum() == pytest.approx(np.pi * 1.25**2, rel=0.1)
        np.testing.assert_allclose(first, last, atol=1e-6)


def test_views_are_lit_in_turn_and_other_paths_light_all() -> None:
    patterns = np.stack([moving_light("views", VIEWS, time) for time in (0, 1)])
    assert np.array_equal(patterns.reshape(2, 2, -1).min(2), np.eye(2))
    assert moving_light("across", VIEWS, 0.5).shape == VIEWS
    for path in ("acros", "views"):
        with pytest.raises(InputError, match=f"path of the light: '{path}'; expected across, down"):
            moving_light(path, PROJECTOR, 0)


# --- relit pictures and movies


def swept(transport: DenseTransport, count: int):
    times = np.linspace(0, 1, count)
    patterns = [moving_light("across", PROJECTOR, time) for time in times]
    return list(relit_pictures(transport, patterns))


def test_relit_pictures_equal_relight() -> None:
    transport = transport_of(VIEWS)
    pattern = RANDOM.random((*PROJECTOR, 3), dtype=np.float32)
    (picture,) = relit_pictures(transport, [pattern])
    np.testing.assert_array_equal(picture, transport.relight(pattern).reshape(8, 6, 3))


def test_a_movie_shows_the_relit_pictures(tmp_path: Path) -> None:
    transport, path = transport_of((5, 9)), tmp_path / "movie.mp4"
    white = relit_movie(transport, path, "across", 6, enlarge=9, fps=12.5)
    frames = frames_of(path)
    assert frames.shape == (6, 46, 82, 3)  # odd sides are padded
    expected = [
        255 * srgb(picture, white).repeat(9, 0).repeat(9, 1) for picture in swept(transport, 6)
    ]
    off = np.abs(frames[:, :45, :81] - np.stack(expected))
    assert off.mean() < 4  # noise; the format stores colour for squares of four pixels
    assert np.abs((frames[:, :45, :81] - np.stack(expected)).mean((0, 1, 2))).max() < 1.5
    with av.open(str(path)) as container:
        assert container.streams.video[0].average_rate == 12.5


def test_all_pictures_share_a_white_level(tmp_path: Path) -> None:
    transport, path = transport_of(), tmp_path / "movie.mp4"
    brightest = max(picture.max() for picture in swept(transport, 5))
    assert 0.9 * brightest < relit_movie(transport, path, "across", 5) <= brightest
    assert relit_movie(transport, path, "across", 5, white=3.0) == 3.0
    with pytest.raises(InputError, match="white is 0"):
        relit_movie(transport, path, "across", 5, white=0)


def test_a_movie_is_complete_or_absent(tmp_path: Path) -> None:
    def pictures():
        yield np.zeros((32, 32, 3), np.uint8)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_movie(tmp_path / "movie.mp4", pictures(), 25)
    assert not list(tmp_path.iterdir())


def test_movies_that_can_t_be_written_are_refused(tmp_path: Path, monkeypatch) -> None:
    picture = np.zeros((32, 32, 3), np.uint8)
    with pytest.raises(InputError, match=r"expected \.mp4"):
        write_movie(tmp_path / "movie.gif", [picture], 25)
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(StoreError, match=r"pip install .*\[export\]"):
        write_movie(tmp_path / "movie.mp4", [picture], 25)


# --- commands


def test_export_matrix(stored: Path, tmp_path: Path) -> None:
    path = tmp_path / "part.npz"
    text = run("export", stored, "-o", path, "--rows", "2,:", "--rows", "2,3", "--columns", "0,0")
    assert "part.npz: T" in text
    exported = np.load(path)
    assert exported["rows"].tolist() == list(range(16, 24))  # each ray once
    np.testing.assert_allclose(exported["T"], transport_of().toarray(range(16, 24), [0]), rtol=1e-6)
    run("export", stored, "-o", path, "--coarser", "2", "--dual")
    np.testing.assert_allclose(
        np.load(path)["T"], coarser(transport_of(), 2).T.toarray(), rtol=1e-6
    )


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("x.npz", ("--limit-gib", "1e-6"), "choose rows or columns, join rays"),
        ("x.npz", ("--rows", "9,9"), "outside the rays"),
        ("rays", (), ".npz"),
    ],
)
def test_export_refuses_invalid_arguments(
    stored: Path, tmp_path: Path, name: str, options, message: str
) -> None:
    assert message in refused("export", stored, "-o", tmp_path / name, *options)
    assert not (tmp_path / name).exists()


def test_relight_accepts_names_pictures_and_stacks(stored: Path, tmp_path: Path) -> None:
    weights = np.linspace(0, 1, 35, dtype=np.float32).reshape(*PROJECTOR, 1)
    write_image(tmp_path / "ramp.exr", weights)
    np.save(tmp_path / "stack.npy", RANDOM.random((2, *PROJECTOR, 3)))
    folder = tmp_path / "relit"
    np.save(tmp_path / "one.npy", weights[..., 0])
    lights = ("noise", tmp_path / "ramp.exr", tmp_path / "stack.npy", tmp_path / "one.npy")
    text = relit(stored, folder, *lights)
    names = ["noise", "one", "ramp", "stack_0000", "stack_0001"]
    assert "5 pictures" in text
    assert sorted(path.stem for path in folder.iterdir()) == names
    transport = transport_of()
    for name, pattern in {
        "ramp": weights[..., 0],
        "noise": relighting_patterns(PROJECTOR)["noise"],
        "stack_0001": np.load(tmp_path / "stack.npy")[1],
    }.items():
        picture = read_image(folder / f"{name}.exr")
        np.testing.assert_allclose(picture, transport.relight(pattern), rtol=1e-5)
    relit(stored, tmp_path / "all.npy", *lights)
    assert (np.load(tmp_path / "all.npy")[4] == read_image(folder / "one.exr")).all()


def test_relight_to_png_has_one_white_level(stored: Path, tmp_path: Path) -> None:
    np.save(tmp_path / "stack.npy", np.array([np.ones(PROJECTOR), 0.1 * np.ones(PROJECTOR)]))
    relit(stored, tmp_path / "relit", tmp_path / "stack.npy", options=("--format", "png"))
    bright, dim = (read_image(tmp_path / "relit" / f"stack_000{n}.png") for n in (0, 1))
    assert bright.max() > 0.99
    assert dim.max() < 0.4


def test_relight_refuses_wrong_input(stored: Path, tmp_path: Path) -> None:
    np.save(tmp_path / "counts.npy", np.full((1, *PROJECTOR), 255, np.uint8))
    np.save(tmp_path / "flat.npy", np.ones(3))
    folder = tmp_path / "relit"
    text = relit(stored, folder, tmp_path / "counts.npy", by=refused)
    assert "uint8 with values from 255 to 255" in text
    assert "two patterns are named noise" in relit(stored, folder, "noise", "noise", by=refused)
    assert "a pattern has the shape" in relit(stored, folder, tmp_path / "flat.npy", by=refused)


def test_export_movie(stored: Path, tmp_path: Path) -> None:
    path = tmp_path / "movie.mp4"
    options = ("--path", "circle", "--seconds", "0.2", "--white", "4")
    assert "5 pictures, white is 4" in run("movie", stored, "-o", path, *options)
    assert frames_of(path).shape == (5, 360, 480, 3)
    assert "0 pictures" in refused("movie", stored, "-o", path, "--seconds", "0")
