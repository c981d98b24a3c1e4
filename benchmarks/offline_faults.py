"""Reactions of `rfpipe import` to pictures with faults, and to good pictures.

``python -m benchmarks.offline_faults`` takes the first two sheets of a scene by a camera with
noise, spoils each in twelve ways, and prints a table of messages and of imported levels. With
``--good`` it imports good pictures of scenes, brightnesses and seeds instead, and counts refusals.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
import yaml
from tests.examples import photographer
from typer.testing import CliRunner

from rfpipe.cli import app
from rfpipe.config import CameraConfig, SceneSettings
from rfpipe.photometry import CameraModel
from rfpipe.pictures import picture_files, read_picture
from rfpipe.pictures.order import TURNS
from rfpipe.scenes import scene_from_config

SCENES: dict[str, dict[str, Any]] = {
    "room": {"kind": "coloured_room"},
    "plane": {"kind": "plane", "surfaces": ["white"]},
    "texture": {"kind": "plane", "surfaces": ["texture"]},
    "wedge": {"kind": "wedge", "surfaces": ["texture", "texture"]},
    "wedge_30": {"kind": "wedge_30", "surfaces": ["white", "white"]},
    "sphere": {"kind": "sphere_on_plane"},
    "white room": {"kind": "room"},
    "mirror": {"kind": "wedge", "surfaces": ["texture", "texture"]},
}
EXPOSURES = [0.015625, 0.0625, 0.25, 1.0]


class Series:
    """An acquisition with pictures of a simulated camera, in a separate folder."""

    def __init__(self, folder: Path, scene: str, side: int, light: float, seed: int) -> None:
        self.folder, self.seed = folder, seed
        camera = {"exposures": EXPOSURES, "bits": 16, "electrons_per_radiance": 640_000 * light}
        self.camera = CameraModel(**CameraConfig(**camera).model_dump())
        options = {**SCENES[scene], "shape": [side, side], "channels": 1}
        simulated = scene_from_config(SceneSettings.model_validate(options))
        self.matrix = simulated.dense(0)[None]
        if scene == "mirror":  # in its lower right quarter, where it rotates the picture
            rays = np.arange(side**2).reshape(side, side)[side // 2 :, side // 2 :].ravel()
            bright = np.diag(self.matrix[0])[rays].mean()
            self.matrix[0][np.ix_(rays, rays)] = bright * np.eye(len(rays))[::-1]
        settings = {
            "scenes": {"desk": {"kind": "captured", "shape": [side, side], "channels": 1}},
            "methods": {"near_far": {}},
            "camera": camera,
            "capture": {"rig": "offline", "all_off_brackets": 4, "all_on_brackets": 4},
            "offline": {"projector_shape": [3 * side, 3 * side]},
        }
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "mine.yaml").write_text(yaml.safe_dump(settings))
        self.run("patterns", folder / "mine.yaml", "-o", folder, "--results", folder / "results")

    def run(self, *arguments: object) -> str:
        """Run a command of rfpipe; return its output or its error."""
        done = CliRunner().invoke(app, [str(argument) for argument in arguments])
        return done.output if done.exception is None else f"REFUSED {done.exception}"

    @property
    def sheet(self) -> Path:
        """The last sheet that was written."""
        return max(self.folder.glob("desk_*"))

    def photograph(self) -> None:
        """Take the pictures of the last sheet, each with independent noise."""
        random = np.random.default_rng([self.seed, len(self.sheet.name), ord(self.sheet.name[-1])])

        def expose(radiance: Any, seconds: float, _key: Any) -> Any:
            key = (int(random.integers(2**31)),)
            light = np.asarray(radiance, np.float32)
            return self.camera.expose(light, self.seed, key)[EXPOSURES.index(seconds)]

        photographer.photograph(self.sheet, self.matrix, expose)

    def kept(self, sheet: Path) -> bool:
        """Test whether a sheet's level has stored pictures."""
        frames = self.folder.glob(f"results/desk/*/{sheet.name[-3:]}/*.zarr/journal.jsonl")
        return any(path.stat().st_size for path in frames)


def brackets(pictures: Path) -> list[list[Path]]:
    """Return the files of a folder, a list a bracket."""
    files, step = picture_files(pictures), len(EXPOSURES)
    return [files[first : first + step] for first in range(0, len(files), step)]


def change(path: Path, pixels: Any) -> None:
    """Write other pixels into a picture, with its exposure time."""
    seconds = read_picture(path).header.exposure_s
    picture = oiio.ImageBuf(np.ascontiguousarray(pixels))
    picture.specmod().attribute("ExposureTime", seconds)
    assert picture.write(str(path))


def each(of: list[list[Path]], how: Callable[[Any], Any]) -> None:
    """Change all pictures of some brackets."""
    for path in [path for bracket in of for path in bracket]:
        change(path, how(read_picture(path).pixels))


def swap(first: list[Path], second: list[Path]) -> None:
    """Exchange two brackets."""
    for path, partner in zip(first, second, strict=True):
        aside = path.with_name("aside")
        path.rename(aside)
        partner.rename(path)
        aside.rename(partner)


def renumber(pictures: Path, files: list[Path]) -> None:
    """Renumber pictures in this order; a file may occur twice."""
    aside = pictures.with_name("aside")
    pictures.rename(aside)
    pictures.mkdir()
    for index, path in enumerate(files):
        shutil.copy(aside / path.name, pictures / f"IMG_{index}.tif")
    shutil.rmtree(aside)


def faults(pictures: Path, seed: int) -> Iterator[tuple[str, Callable[[], None]]]:
    """Yield a name of each fault, and what brings it about."""
    of, random = brackets(pictures), np.random.default_rng(seed)
    dropped = 2 + int(random.integers(len(of) - 3))
    flat = [path for bracket in of for path in bracket]
    remaining = [path for index, bracket in enumerate(of) if index != dropped for path in bracket]
    yield "a picture missing", flat[dropped * len(EXPOSURES)].unlink
    yield "a bracket missing", lambda: renumber(pictures, remaining)
    twice = flat[: (dropped + 1) * len(EXPOSURES)] + flat[dropped * len(EXPOSURES) :]
    yield "a bracket twice", lambda: renumber(pictures, twice)
    yield "two exchanged", lambda: swap(of[-2], of[-3])
    copied = [*flat[: -3 * len(EXPOSURES)], *of[-2], *of[-2], *of[-1]]
    yield "one copied", lambda: renumber(pictures, copied)
    for turn in list(TURNS)[1:4]:
        yield f"all {turn}", lambda turn=turn: each(of, TURNS[turn])  # type: ignore[misc]
    yield "all transposed", lambda: each(of, TURNS["mirrored along the diagonal"])
    yield "all mirrored", lambda: each(of, TURNS["mirrored left to right"])
    yield "one turned", lambda: each([of[-2]], TURNS["turned by 180 degrees"])
    yield "wrong size", lambda: each([of[dropped]], lambda pixels: pixels[:-1])
    yield "8 bits", lambda: each(of, lambda pixels: (pixels >> 8).astype(np.uint8))
    yield "8 bits as 16", lambda: each(of, lambda pixels: (pixels >> 8) * np.uint16(257))
    yield "8 bits in 16", lambda: each(of, lambda pixels: pixels >> 8)
    yield (
        "one of noise",
        lambda: each(
            [of[-2]], lambda pixels: random.integers(64, 20000, pixels.shape).astype(np.uint16)
        ),
    )


def spoil(scene: str, side: int, light: float, seed: int) -> None:
    """Print the message for each fault, in the first two sheets."""
    with tempfile.TemporaryDirectory() as folder:
        series = Series(Path(folder), scene, side, light, seed)
        for _ in range(2):
            series.photograph()
            sheet = series.sheet
            good = shutil.copytree(sheet / "pictures", Path(folder, "good"), dirs_exist_ok=True)
            for name, bring_about in faults(sheet / "pictures", seed):
                bring_about()
                said = series.run("import", sheet).replace(f"{sheet}/", "").replace("\n", " ")
                print(f"| {sheet.name[-3:]} | {name} | {series.kept(sheet)} | {said} |", flush=True)
                shutil.rmtree(sheet / "pictures")
                shutil.copytree(good, sheet / "pictures")
            shutil.rmtree(good)
            print(series.run("import", sheet))


def import_good(side: int, lights: list[float], seeds: range) -> None:
    """Import good pictures, all sheets of each acquisition, and print those that are refused."""
    count = 0
    for scene in SCENES:
        for light in lights:
            for seed in seeds:
                with tempfile.TemporaryDirectory() as folder:
                    series, said = Series(Path(folder), scene, side, light, seed), ""
                    while "nothing more" not in said:
                        series.photograph()
                        count += 1
                        said = series.run("import", series.sheet)
                        if said.startswith("REFUSED"):
                            print(f"{scene}, light {light}, seed {seed}: {said}", flush=True)
                            break
        print(f"{scene}: {count} sheets so far", flush=True)


def main() -> None:
    """Read the command line, and go on."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--good", action="store_true", help="import good pictures")
    parser.add_argument("--scene", default="room", choices=list(SCENES))
    parser.add_argument("--side", type=int, default=32, help="rays of a side")
    parser.add_argument("--light", type=float, nargs="+", default=[1.0], help="times the usual")
    parser.add_argument("--seeds", type=int, nargs=2, default=(0, 1), help="from, to below")
    arguments = parser.parse_args()
    if arguments.good:
        import_good(arguments.side, arguments.light, range(*arguments.seeds))
    else:
        spoil(arguments.scene, arguments.side, arguments.light[0], arguments.seeds[0])


if __name__ == "__main__":
    main()
