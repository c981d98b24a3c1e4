"""Results of config/large.yaml: errors against pictures on the rig, and resources of each stage.

Usage: ``python -m benchmarks.large [FOLDER]``, the folder that holds the run's ``results``, by
default ``large``. Writes docs/measured/large.csv, a row for each acquisition after each level,
docs/measured/large_stages.csv, and docs/images/large.png. True errors are over pictures that no
method used, of the scene without noise; ``verified`` is over other pictures, taken with noise.
"""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from benchmarks.harness import existing, given
from rfpipe.array_types import Float
from rfpipe.config import Config, load_config
from rfpipe.relighting import picture_errors, relighting_pictures
from rfpipe.scenes import Scene, scene_from_config
from rfpipe.stages.plan import Plan
from rfpipe.stages.settings import plan_settings
from rfpipe.stages.verification import verify
from rfpipe.storage.base import scheduled_levels
from rfpipe.storage.files import FolderStorage
from rfpipe.storage.picture_counts import captured_pictures
from rfpipe.store import open_arrays
from rfpipe.store.files import write_atomically
from rfpipe.transport.base import estimates

SETTINGS = Path("config/large.yaml").absolute()
TABLES, PICTURE = Path("docs/measured").absolute(), Path("docs/images/large.png").absolute()
_PICTURES, _SEED = 48, 3000  # other ones than the report's and the verification's
_AT_A_TIME = 8


def main(folder: Path) -> None:
    """Write the tables and the picture."""
    os.chdir(folder)  # where a run's settings look for files
    config = load_config(SETTINGS)
    rows: list[dict[str, Any]] = []
    for name, settings in config.scenes.items():
        scene = scene_from_config(settings)
        test = pictures_of(scene)
        for method in config.methods_of(name):
            rows += curve(config, name, method, scene, test)
            print(pd.DataFrame(rows[-1:]).to_string(index=False), flush=True)
    table = pd.DataFrame(rows)
    text = table.to_csv(index=False, float_format="%.4g", lineterminator="\n")
    write_atomically(TABLES / "large.csv", text.encode())
    stages = pd.concat([stage_costs(name, method) for name, method in acquisitions(config)])
    text = stages.to_csv(index=False, lineterminator="\n")
    write_atomically(TABLES / "large_stages.csv", text.encode())
    image = io.BytesIO()
    draw(config, table).savefig(image, format="png", dpi=100)
    write_atomically(PICTURE, image.getvalue())


def acquisitions(config: Config) -> Iterator[tuple[str, str]]:
    """Yield scene and method of each acquisition."""
    for scene in config.scenes:
        for method in config.methods_of(scene):
            yield scene, method


def pictures_of(scene: Scene) -> tuple[Float, Float, Float]:
    """Return patterns (P, *projector_shape), their images and the floodlit one, without noise."""
    patterns = relighting_pictures(scene.projector_shape, _PICTURES, _SEED)
    white = np.ones((1, *scene.projector_shape), np.float32)
    images = scene.apply(np.concatenate([patterns, white]))
    images = images.reshape(-1, *scene.camera_shape, scene.channels)
    return patterns, images[:-1], images[-1]


def curve(
    config: Config, name: str, method: str, scene: Scene, test: tuple[Float, Float, Float]
) -> Iterator[dict[str, Any]]:
    """Yield pictures, estimated and true errors of an acquisition after each of its levels."""
    patterns, truth, floodlit = test
    folder = FolderStorage(Path("results") / name / method)
    plan = Plan.of(**plan_settings(config, name, method))
    plan = plan.for_measured_rig(folder)
    dark = patterns == 0 if config.scenes[name].is_coaxial else None
    levels = list(scheduled_levels(folder))
    for level in levels:
        state = plan.restored_state(folder, level + 1)
        transport = plan.method.transport(state)
        relit = np.concatenate(
            [
                transport.relight_batch(patterns[first : first + _AT_A_TIME])
                for first in range(0, len(patterns), _AT_A_TIME)
            ]
        )
        errors, indirect = picture_errors(relit, truth, patterns, floodlit, dark)
        known = estimates(transport.level_rows)
        verified = np.nan if level < levels[-1] else verify(folder, transport).mean_error
        yield {
            "scene": name,
            "method": method,
            "rays": int(np.prod(scene.projector_shape)),
            "patterns": sum(row["patterns"] for row in transport.level_rows),
            "pictures": captured_pictures(folder, level).total,
            "megabytes": transport.nbytes / 1e6,
            "estimated_error": known[-1]["estimated_error"] if known else np.nan,
            "mean_error": float(errors.mean()),
            "worst_error": float(errors.max()),
            "mean_indirect": float(np.nanmean(indirect)) if dark is not None else np.nan,
            "verified": verified,
            "grain": scene.recorded["grain"]["whole"],
        }


def stage_costs(scene: str, method: str) -> pd.DataFrame:
    """Return jobs, seconds, processor seconds and peak memory of each stage of an acquisition."""
    rows = []
    folder = Path("results") / scene / method
    for path in [*folder.glob("*.benchmark.tsv"), *folder.glob("L*/*.benchmark.tsv")]:
        job = pd.read_csv(path, sep="\t", na_values="-").iloc[0]
        stage = path.name.removesuffix(".benchmark.tsv")
        rows.append([stage, job["s"], job["cpu_time"], job["max_rss"] / 1024])
    jobs = pd.DataFrame(rows, columns=["stage", "seconds", "processor_s", "memory_gib"])
    stages = jobs.groupby("stage", sort=False).agg(
        jobs=("seconds", "size"),
        seconds=("seconds", "sum"),
        processor_s=("processor_s", "sum"),
        memory_gib=("memory_gib", "max"),
    )
    stages = stages.round({"seconds": 0, "processor_s": 0, "memory_gib": 2}).reset_index()
    stages.insert(0, "method", method)
    stages.insert(0, "scene", scene)
    return stages


def draw(config: Config, table: pd.DataFrame) -> Any:
    """Draw, of each scene, truth and relit pictures under a pattern, and errors by pictures."""
    figure, axes = plt.subplots(len(config.scenes), 4, figsize=(16, 3.2 * len(config.scenes)))
    for row, name in zip(axes, config.scenes, strict=True):
        shown = open_arrays(Path("results") / name / "auto/relight.zarr")
        truth, relit = shown.read("truth")[0], shown.read("relit")[0]
        floodlit = shown.read("floodlit_truth")
        white = float(np.percentile(floodlit, 99.5))
        titles = f"{name}, floodlit", "under a bar of light, x 4", "relit, auto, x 4"
        images = floodlit, 4 * truth, 4 * relit
        for axis, image, title in zip(row, images, titles, strict=False):
            axis.imshow(np.clip(image / white, 0, 1) ** (1 / 2.2))
            axis.set_title(title)
            axis.axis("off")
        for method, method_rows in table[table["scene"] == name].groupby("method", sort=False):
            [line] = row[3].loglog(
                method_rows["pictures"], 100 * method_rows["mean_error"], "o-", label=method
            )
            made = method_rows[
                method_rows["estimated_error"] != method_rows["estimated_error"].shift()
            ]
            row[3].loglog(
                made["pictures"], 100 * made["estimated_error"], "x:", color=line.get_color()
            )
        row[3].set_xlabel("pictures on the rig")
        row[3].set_title("error, %: true (o), estimated (x)")
        row[3].grid(alpha=0.3)
        row[3].legend()
    figure.tight_layout()
    return figure


if __name__ == "__main__":
    main(*given("folder", existing, [Path("large")])[:1])
