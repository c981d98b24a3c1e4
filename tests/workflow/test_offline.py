"""Offline rigs: patterns are written to files, and pictures are imported from files."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
import pytest
import yaml
from tests.examples import photographer
from tests.files.dng import dng_bytes
from tests.workflow.harness import Workflow
from tests.workflow.stagewise import acquire, contents, symmetric_matrix
from typer.testing import CliRunner

from rfpipe import OperatorRig, open_transport
from rfpipe.cli import app
from rfpipe.config import CameraConfig, Config, load_config, parse_config
from rfpipe.errors import InputError, RfpipeError
from rfpipe.photometry import CameraModel
from rfpipe.pictures import read_picture
from rfpipe.rigs.offline import offline_rig, read_sheet
from rfpipe.stages import verification
from rfpipe.stages.context import CaptureContext
from rfpipe.stages.plan import Plan
from rfpipe.stages.rig_sources import rig_source
from rfpipe.stages.settings import (
    AcquisitionSettings,
    plan_settings,
    rig_source_settings,
    stage_settings,
)
from rfpipe.storage.base import VERIFICATION_MANIFEST
from rfpipe.storage.files import FolderStorage
from rfpipe.store import read_manifest, write_manifest

SHAPE = (4, 5)
SETTINGS: dict[str, Any] = {
    "scenes": {"desk": {"kind": "captured", "shape": list(SHAPE), "channels": 1}},
    "methods": {"symmetric": {}},
    "camera": {"exposures": [0.015625, 0.25]},
    "capture": {"rig": "offline", "all_off_brackets": 2, "all_on_brackets": 2},
    "offline": {"projector_shape": [26, 33]},
}
CAMERA = CameraModel(**CameraConfig(**SETTINGS["camera"]).model_dump())


def command(*arguments: object, fails: bool = False) -> str:
    done = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if fails:
        assert isinstance(done.exception, RfpipeError), done.output
        return str(done.exception)
    assert done.exception is None, done.exception
    return done.output


def settings_file(folder: Path, **changes: Any) -> Path:
    path = folder / "mine.yaml"
    path.write_text(yaml.safe_dump({**SETTINGS, **changes}))
    return path


def sheets(folder: Path) -> list[Path]:
    return sorted(path for path in folder.glob("desk_*") if path.is_dir())


@pytest.fixture
def level_0(tmp_path: Path) -> Path:
    """Folder of the first sheet with its pictures; settings and pictures are free of noise."""
    path = settings_file(tmp_path, camera=QUIET)
    command("patterns", path, "-o", tmp_path / "p", "--results", tmp_path / "r")
    (sheet,) = sheets(tmp_path / "p")
    photographer.photograph(sheet, symmetric_matrix()[None], photographer.counts)
    return sheet


def test_the_photographer_takes_colour_pictures(level_0: Path) -> None:
    matrix = np.repeat(symmetric_matrix()[None], 3, axis=0)
    photographer.photograph(level_0, matrix, photographer.counts)
    assert read_picture(level_0 / "pictures" / "IMG_0.tif").header.channels == 3


QUIET = {"exposures": [0.5, 2.0], "bits": 16, "black_level_counts": 1000}


def test_an_offline_acquisition_has_the_bytes_of_a_direct_one(tmp_path: Path) -> None:
    """Pictures are taken by an independent script, with the noise of the simulated rig."""
    path = settings_file(tmp_path)
    settings = load_config(path)
    rig = OperatorRig(symmetric_matrix(), SHAPE, SHAPE, CAMERA, seed=3)
    direct = tmp_path / "direct"
    acquire(
        direct,
        rig,
        Plan.of(**plan_settings(settings, "desk", "symmetric")),
        settings_of(settings),
    )

    def expose(radiance: Any, seconds: float, key: Any) -> Any:
        # markers are used by the import only
        bracket = CAMERA.expose(radiance.astype(np.float32), 3, tuple(key or (9,)))
        return bracket[CAMERA.exposures.index(seconds)]

    output = command("patterns", path, "-o", tmp_path / "p", "--results", tmp_path / "r")
    passes = 0
    while "complete; the transport is" not in output:
        assert re.search(r"level \d has \d+ patterns and 3 markers", output)
        sheet = sheets(tmp_path / "p")[-1]
        photographer.photograph(sheet, symmetric_matrix()[None], expose)
        output = command("import", sheet)
        passes += 1
    assert passes == len(sheets(tmp_path / "p")) > 2
    transport = contents(tmp_path / "r" / "desk" / "symmetric" / "transport.zarr")
    assert transport == contents(direct / "transport.zarr")
    # importing a sheet again changes nothing
    assert "complete; the transport is" in command("import", sheet)
    assert verified(path, tmp_path / "r")["mean_error"] < 0.01


def settings_of(config: Config) -> AcquisitionSettings:
    return AcquisitionSettings(**stage_settings(config, "desk", "symmetric"))


def verified(path: Path, results: Path) -> dict[str, Any]:
    """Run the verification of a finished acquisition, like the workflow."""
    settings = load_config(path)
    rig = rig_source_settings(settings, "desk")
    assert rig["kind"] == "offline"
    folder = FolderStorage(results / "desk" / "symmetric")
    context = CaptureContext(folder, settings_of(settings), rig_source=rig_source(**rig))
    verification.run(context, settings.verification_pictures)
    return read_manifest(results / "desk" / "symmetric" / VERIFICATION_MANIFEST)


def acquired(tmp_path: Path, settings: Path, matrix_of: Any) -> list[str]:
    """Take and import the pictures of each sheet; `matrix_of(sheet)` is the scene's transport."""
    at = "-o", tmp_path / "p", "--results", tmp_path / "r"
    outputs = [command("patterns", settings, *at)]
    while "complete; the transport is" not in outputs[-1]:
        newest = max(sheets(tmp_path / "p"), key=lambda sheet: sheet.stat().st_mtime_ns)
        photographer.photograph(newest, matrix_of(newest)[None], photographer.counts)
        outputs.append(command("import", newest))
    return outputs


def test_verification_detects_a_camera_moved_between_sheets(
    tmp_path: Path,
) -> None:
    path = settings_file(tmp_path, camera=QUIET)
    moved = np.roll(np.diag(np.linspace(0.2, 1, 20)), 1, axis=0) + 0.1 * symmetric_matrix()
    still = np.diag(np.linspace(0.2, 1, 20)) + 0.1 * symmetric_matrix()
    acquired(tmp_path, path, lambda sheet: still if sheet.name.endswith("L00") else moved)
    assert verified(path, tmp_path / "r")["mean_error"] > 0.2


def test_verification_pictures_requested_later_have_a_separate_sheet(tmp_path: Path) -> None:
    path = settings_file(tmp_path, camera=QUIET, verification={"pictures": 0})
    acquired(tmp_path, path, lambda _: symmetric_matrix())
    assert not (tmp_path / "r" / "desk" / "symmetric" / "verification").exists()
    settings_file(tmp_path, camera=QUIET, verification={"pictures": 4})
    outputs = acquired(tmp_path, path, lambda _: symmetric_matrix())
    assert "verification has 4 patterns and 3 markers" in outputs[0]
    sheet = tmp_path / "p" / "desk_symmetric_verification"
    assert verified(path, tmp_path / "r")["mean_error"] < 0.01
    command("import", sheet, "--take-back")
    assert not list((tmp_path / "r" / "desk" / "symmetric").glob("verification*"))
    assert (tmp_path / "r" / "desk" / "symmetric" / "transport.json").exists()


@pytest.mark.slow
def test_the_workflow_continues_from_imported_pictures(tmp_path: Path) -> None:
    workflow = Workflow(tmp_path)
    settings = {**SETTINGS, "camera": QUIET, "methods": {"brute_force": {}}}
    workflow.config.write_text(yaml.safe_dump(settings))
    target = "results/desk/brute_force/relight.json"
    output = workflow.run(target, succeeds=False)
    assert "level 0 waits for pictures" in output
    results = tmp_path / "results"
    command("patterns", workflow.config, "-o", tmp_path / "p", "--results", results)
    (sheet,) = sheets(tmp_path / "p")
    np.save(tmp_path / "matrix.npy", symmetric_matrix()[None])
    done = subprocess.run(
        [sys.executable, photographer.__file__, sheet, tmp_path / "matrix.npy"], check=False
    )
    assert done.returncode == 0
    assert "complete; the transport is" in command("import", sheet)
    assert "patterns in" not in workflow.run(target)
    transport = open_transport(workflow.path("desk/brute_force/transport.zarr"))
    # radiance in units of the camera
    estimate = transport.channel(0) @ np.eye(20)
    scale = estimate.sum() / symmetric_matrix().sum()
    np.testing.assert_allclose(estimate / scale, symmetric_matrix(), atol=2e-3 / 20)


def test_patterns_are_as_the_projector_shows_them(level_0: Path) -> None:
    stated = json.loads((level_0 / "patterns.json").read_text())
    names = [entry["file"] for entry in stated["shown"]]
    assert [name[5:-4] for name in names] == [
        *("marker",) * 2, "black", *("white",) * 2, "black", *("random",) * 6, "pattern",
        *("verification",) * 3, "marker",
    ]  # fmt: skip
    white = oiio.ImageBuf(str(level_0 / names[4])).get_pixels(oiio.UINT8)[..., 0]
    assert white.shape == (26, 33)
    lit = np.zeros((26, 33), bool)
    lit[1:25, 1:31] = True  # 4 x 5 squares of 6 x 6 pixels in the middle
    np.testing.assert_array_equal(white > 0, lit)


def swapped(pictures: Path, *pairs: tuple[int, int]) -> None:
    """Exchange pairs of pictures; by default, move the inverted marker behind black."""
    for first_index, second_index in pairs or ((2, 4), (3, 5)):
        first, second = (pictures / f"IMG_{index}.tif" for index in (first_index, second_index))
        first.rename(pictures / "aside.tif")
        second.rename(first)
        (pictures / "aside.tif").rename(second)


def rewritten(name: str, change: Any, seconds: float | None = None) -> Any:
    def rewrite(pictures: Path) -> None:
        picture = read_picture(pictures / name)
        changed = oiio.ImageBuf(np.ascontiguousarray(change(picture.pixels)))
        changed.specmod().attribute("ExposureTime", seconds or picture.header.exposure_s)
        assert changed.write(str(pictures / name))

    return rewrite


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda folder: (folder / "IMG_3.tif").unlink(), "IMG_4.*a picture before it is missing"),
        (
            lambda folder: (folder / "IMG_33.tif").unlink(),
            "has 33 pictures; .* has 17 patterns of 2",
        ),
        (rewritten("IMG_5.tif", lambda pixels: pixels, 1.0), r"IMG_5.*exposed for 1 s.*0\.5, 2 s"),
        (rewritten("IMG_6.tif", lambda pixels: pixels[:3]), r"3 x 5 pixels.*expected 4 x 5"),
        (rewritten("IMG_7.tif", lambda pixels: pixels.repeat(3, axis=2)), "has 3 channels"),
        (rewritten("IMG_7.tif", lambda pixels: pixels / np.float32(9)), "has light"),
        (rewritten("IMG_8.tif", lambda pixels: np.full_like(pixels, 65535)), "add a shorter one"),
        (rewritten("IMG_7.tif", lambda pixels: np.full_like(pixels, 1000)), "lens cap"),
        (swapped, "doesn't begin with the marker"),
    ],
)
def test_wrong_pictures_are_refused_before_any_is_imported(
    level_0: Path, spoil: Any, message: str
) -> None:
    spoil(level_0 / "pictures")
    assert re.search(message, command("import", level_0, fails=True))
    assert not list(level_0.parents[1].glob("r/desk/symmetric/L00/reference_brackets.zarr/c.*"))


def test_exchanged_pictures_are_refused_and_a_sheet_can_be_withdrawn(level_0: Path) -> None:
    photographer.photograph(level_0, (np.eye(20) + 0.02)[None], photographer.counts)
    exchange = partial(swapped, level_0 / "pictures", (12, 14), (13, 15))
    level = level_0.parents[1] / "r" / "desk" / "symmetric" / "L00"
    exchange()
    assert "IMG_12.tif shows the pattern of IMG_14.tif" in command("import", level_0, fails=True)
    assert not list(level.glob("reference_brackets.zarr/c.*"))
    assert "None of these pictures" in command("import", level_0, "--anyway", fails=True)
    assert not level.exists()
    exchange()
    command("import", level_0)
    (_, level_1) = sheets(level_0.parent)
    taken_back = command("import", level_0, "--take-back").replace("\n", "")
    assert f"{level}: removed" in taken_back
    assert f"{level_1}: removed" in taken_back
    assert not level.exists()
    assert sheets(level_0.parent) == [level_0]
    assert len(list((level_0 / "pictures").iterdir())) == 34


def test_a_later_sheet_with_pictures_is_not_removed(level_0: Path) -> None:
    command("import", level_0)
    (_, level_1) = sheets(level_0.parent)
    picture = level_1 / "pictures" / "IMG_0.tif"
    picture.write_bytes(b"a picture")
    assert "move them away" in command("import", level_0, "--take-back")
    assert picture.exists()


def test_counts_beyond_the_camera_s_bits_are_refused(level_0: Path) -> None:
    settings_file(level_0.parents[1], camera={**QUIET, "bits": 12})
    rewritten("IMG_8.tif", lambda pixels: pixels >> 4 << 4)(level_0 / "pictures")
    assert "camera.bits" in command("import", level_0, fails=True)


def test_a_sheet_with_other_pictures_is_not_replaced(level_0: Path) -> None:
    root = level_0.parents[1]
    path = settings_file(root, camera={**QUIET, "exposures": [0.1]})
    output = command("patterns", path, "-o", root / "p", "--results", root / "r", fails=True)
    assert "move them to another folder" in output
    with pytest.raises(InputError, match="rfpipe patterns"):
        read_sheet(root)


@pytest.mark.parametrize("is_renamed", [False, True])
def test_a_copied_run_imports_into_its_own_results(level_0: Path, is_renamed: bool) -> None:
    root = level_0.parents[1]
    copied = root.with_name(f"{root.name}_other")
    shutil.move(root, copied) if is_renamed else shutil.copytree(root, copied)
    assert "brackets imported" in command("import", copied / level_0.relative_to(root))
    assert list(copied.glob("r/desk/symmetric/L00/reference_brackets.zarr/c.*"))
    assert not list(root.glob("r/desk/symmetric/L00/reference_brackets.zarr/c.*"))
    assert str(root) + "/" not in (sheets(copied / "p")[-1] / "patterns.json").read_text()


@pytest.mark.parametrize(
    ("moved_name", "message"), [("mine.yaml", "settings at"), ("r", "results at")]
)
def test_a_sheet_separated_from_its_run_is_refused(
    level_0: Path, moved_name: str, message: str
) -> None:
    root = level_0.parents[1]
    moved = root / "elsewhere"
    (root / moved_name).rename(moved)
    output = command("import", level_0, fails=True)
    assert re.search(rf"patterns\.json: the run's {message} \.\./\.\./{moved_name}.*", output)
    assert "write the patterns again" in output
    settings = moved if moved_name == "mine.yaml" else root / "mine.yaml"
    results = moved if moved_name == "r" else root / "r"
    command("patterns", settings, "-o", root / "p", "--results", results)
    assert "brackets imported" in command("import", level_0)
    assert list(results.glob("desk/symmetric/L00/reference_brackets.zarr/c.*"))


def test_a_sheet_with_absolute_paths_is_refused(level_0: Path) -> None:
    root = level_0.parents[1]
    manifest = level_0 / "patterns.json"
    stated = read_manifest(manifest)
    stated["about"]["results"] = str(root / "r")
    write_manifest(manifest, stated)
    assert "absolute path" in command("import", level_0, fails=True)
    command("patterns", root / "mine.yaml", "-o", root / "p", "--results", root / "r")
    assert "brackets imported" in command("import", level_0)


def test_rays_may_cover_a_part_of_the_pictures() -> None:
    corners = [[[2, 1], [12, 1], [12, 9], [2, 9]]]
    offline = {"picture_shape": [11, 15], "camera_corners": corners}
    settings = parse_config({**SETTINGS, "offline": offline}, "it")
    rig = offline_rig(settings.offline, settings.camera, SHAPE, SHAPE, 1)
    assert rig.picture_shape == (11, 15)
    picture = np.random.default_rng(0).random((11, 15), np.float32)
    mean = picture[1:9, 2:12].reshape(4, 2, 5, 2).mean(axis=(1, 3))
    resampled = rig.sensor.resampling.matrix @ picture.ravel()
    np.testing.assert_allclose(resampled, mean.ravel(), rtol=1e-6)


def test_a_raw_file_of_another_mosaic_is_refused(tmp_path: Path) -> None:
    """Otherwise red and blue would be exchanged, and X-Trans mosaics read as gray."""
    scenes = {"desk": {"kind": "captured", "shape": [36, 48], "channels": 3}}
    changes = {"scenes": scenes, "camera": {**QUIET, "bayer": "RGGB"}}
    path = settings_file(tmp_path, **changes, offline={"projector_shape": [72, 96]})
    command("patterns", path, "-o", tmp_path / "p", "--results", tmp_path / "r")
    (sheet,) = sheets(tmp_path / "p")
    counts = np.full((36, 48), 900, np.uint16)
    x_trans = "GBGGRGRGRBGBGBGGRGGRGGBGBGBRGRGRGGBG"
    for mosaic, message in (("BGGR", "colour mosaic BGGR"), (x_trans, "colour mosaic X-Trans")):
        (sheet / "pictures").mkdir(exist_ok=True)
        (sheet / "pictures" / "IMG_0.dng").write_bytes(dng_bytes(counts, 0.25, mosaic))
        output = command("import", sheet, fails=True)
        assert message in output
        assert "camera.bayer is RGGB" in output


def test_a_raw_file_is_a_mosaic_with_its_exposure_time(tmp_path: Path) -> None:
    mosaic = np.random.default_rng(1).integers(0, 60000, (32, 48)).astype(np.uint16)
    (tmp_path / "a.dng").write_bytes(dng_bytes(mosaic, 0.25))
    picture = read_picture(tmp_path / "a.dng")
    np.testing.assert_array_equal(picture.pixels[..., 0], mosaic)
    assert picture.header.exposure_s == pytest.approx(0.25)
    (tmp_path / "b.dng").write_bytes(b"no raw file")
    with pytest.raises(InputError, match="can't be read as a raw file"):
        read_picture(tmp_path / "b.dng")
