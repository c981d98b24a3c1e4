"""Benchmarks on photographs: their comparisons, and their output without photographs."""

from pathlib import Path

import numpy as np
import pytest
from benchmarks.photographs import __main__ as photographs
from benchmarks.photographs.gray_code import Truth, decoded_pictures

from rfpipe.fitting import Series
from rfpipe.fitting.codes import code_patterns


def test_without_a_folder_the_usage_is_printed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    photographs.main([])
    printed = capsys.readouterr().out
    assert printed.startswith("usage: python -m benchmarks.photographs")
    assert "Give a folder that holds dvrk" in printed
    assert list(tmp_path.iterdir()) == []


def test_sets_that_are_missing_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    photographs.main([str(tmp_path)])
    printed = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in printed] == [f"{tmp_path / s}" for s in ("psm", "dvrk")]
    assert list(tmp_path.iterdir()) == []


def test_truth_of_squares_is_the_mean_of_steady_lit_pixels(tmp_path: Path) -> None:
    column = np.repeat(np.arange(8), 2)[None].repeat(4, axis=0)  # a ray is 2 pixels wide
    column[:, 8:] += 5 * (np.arange(8) % 2)  # with a jump within the last two squares
    row, lit = np.full((4, 16), 7), np.ones((4, 16), np.bool_)
    lit[0, 0], lit[:, 12:] = False, False
    np.savez(tmp_path / "truth.npz", row=row, column=column, lit=lit)
    truth = Truth.read(tmp_path / "truth.npz", 4)
    assert truth.judged.tolist() == [[False, True, False, False]]
    assert truth.lit.tolist() == [[True, True, True, False]]
    assert truth.places[0, 1].tolist() == [7.5, 3.0]  # the middle of the rays 2 and 3


def test_decoding_predicts_direct_light_and_its_left_out_picture() -> None:
    code = code_patterns("gray:8x4,black=none,white=last", 11)
    patterns = np.stack([np.ravel(read()) for read in code.readers])
    rays = [3, 30, 12]
    white = np.array([0.5, 1.0, 0.25], np.float32)
    radiance = (patterns[:, rays] * white)[:, None]
    training = np.setdiff1d(np.arange(11), [4, 5])  # without the finest columns
    series = Series(
        (1, 3), (4, 8), patterns[training], radiance[training], np.zeros_like(radiance[training])
    )
    predicted = decoded_pictures(series, patterns[:6])
    np.testing.assert_allclose(predicted[:4], radiance[:4], rtol=1e-6)
    # of each codeword two rays remain, of which the finest stripes light one
    np.testing.assert_allclose(predicted[4:], 0.5 * white[None, None].repeat(2, axis=0), rtol=1e-6)
