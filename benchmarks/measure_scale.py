"""Memory and processor time of acquisitions of many rays, measured: docs/scale/measured.csv.

Usage: ``python -m benchmarks.measure_scale CASE ... [--size HEIGHTxWIDTH] [--target T]
[--channels C] [--folder FOLDER]``. Each stage runs in a process of its own, whose processor seconds
and peak memory count. The simulated rig and the errors of relit pictures are computed in another
process and don't count. Prints each stage, and appends a row an acquisition to
docs/scale/measured.csv.
"""

from __future__ import annotations

import argparse
import multiprocessing
import shutil
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.harness import errors, image_size
from rfpipe.blocks import RayDomain
from rfpipe.jobs.workers import Resources
from rfpipe.relighting import relighting_pictures
from rfpipe.stages import assemble
from rfpipe.stages.acquisition import LEVEL_STAGES
from rfpipe.stages.context import Acquisition
from rfpipe.stages.plan import Plan
from rfpipe.stages.rig_sources import GivenRig
from rfpipe.stages.settings import AcquisitionSettings
from rfpipe.storage.files import FolderStorage
from rfpipe.store.files import write_atomically
from rfpipe.transport.wavelet import cell_side

MEASURED = Path(__file__).parents[1] / "docs" / "scale" / "measured.csv"
_SEED = 3000  # of the relit pictures, which no method uses
_MEMORY_GIB = 4.0


@dataclass(frozen=True)
class Case:
    """An acquisition.

    Attributes
    ----------
    name, kind : str
        Name of the case; kind of scene, ``wedge``, ``room``, ``views`` of a room, or ``aside``.
    method : str
    target : float
        Target error.
    camera : tuple of int
        Height and width of the camera's image, of each view.
    projector : tuple of int
        Of the projector's image; the camera's where the rig is coaxial.
    views : tuple of int, optional
        Rows and columns of views.
    channels : int
    """

    name: str
    kind: str
    method: str
    target: float
    camera: tuple[int, int]
    projector: tuple[int, int]
    views: tuple[int, int] | None = None
    channels: int = 3

    @property
    def domains(self) -> tuple[RayDomain, RayDomain]:
        """Ray domains of camera and projector."""
        views = () if self.views is None else (self.views[0] * self.views[1],)
        return RayDomain((*views, *self.camera)), RayDomain((*views, *self.projector))


CASES = {
    case.name: case
    for case in (
        Case("wedge", "wedge", "near_far", 0.01, (768, 1024), (768, 1024)),
        Case("room", "room", "near_far", 0.01, (768, 1024), (768, 1024)),
        Case("aside", "aside", "footprints", 0.01, (1500, 2000), (800, 1280)),
        Case("views", "views", "footprints", 0.02, (130, 200), (130, 200), (3, 3)),
    )
}


# --- processes


@cache
def _scene(case: Case) -> Any:
    """Make the scene of a case, once in a process."""
    from rfpipe.scenes.geometries import surface_names
    from rfpipe.scenes.light_field import room_scene
    from rfpipe.scenes.pinholes import Pinhole
    from rfpipe.scenes.rooms import REFERENCE_SCENES, planes_scene

    shape, channels = case.camera, case.channels
    if case.kind == "views":
        return room_scene(("texture", "white", "white"), shape, views=case.views, channels=channels)
    if case.kind == "aside":
        projector = Pinhole(case.projector, position=(0.4, -0.1, 0.0), look_at=(0.0, 0.0, 3.0))
        surfaces = ("texture", "texture")
        return planes_scene("wedge", surfaces, shape, projector=projector, channels=channels)
    if case.kind == "wedge":
        return _planes(*REFERENCE_SCENES["IV"], shape, channels, 2**17)
    names = surface_names("coloured_room")
    return _planes("coloured_room", ["white"] * len(names), shape, channels, 2**14)


def _planes(
    geometry: str, surfaces: Sequence[str], shape: tuple[int, int], channels: int, most_patches: int
) -> Any:
    """Make a coaxial scene; of large images indirect light is computed between patches of pixels.

    More patches take minutes and gigabytes.
    """
    from rfpipe.scenes.geometries import GEOMETRIES
    from rfpipe.scenes.pinholes import surface_points
    from rfpipe.scenes.radiosity import RadiosityScene
    from rfpipe.scenes.rooms import planes_scene

    scene = planes_scene(geometry, surfaces, shape, channels=channels)
    side = cell_side(shape, most_patches)
    if side == 1:
        return scene
    (_, *grid), patch_of_point = RayDomain(shape).square_cells(side)
    patches = surface_points((grid[0], grid[1]), GEOMETRIES[geometry]), patch_of_point
    name = f"{scene.name}, indirect light between patches of {side} x {side} pixels"
    return RadiosityScene(scene.points, scene.albedo, scale=scene.scale, patches=patches, name=name)


@cache
def _rig(case: Case) -> Any:
    """Return the simulated rig; its aperture is closed where the floodlit image is too bright."""
    from rfpipe.photometry import CameraModel
    from rfpipe.rigs import SimulatedRig

    scene, camera = _scene(case), CameraModel()
    floodlit = scene.apply(np.ones((1, case.domains[1].size), np.float32))
    bright = camera.full_well_electrons / camera.exposures[0] / float(np.quantile(floodlit, 0.999))
    electrons = min(camera.electrons_per_radiance, bright)
    return SimulatedRig(scene, replace(camera, electrons_per_radiance=electrons), seed=1)


def _acquisition(case: Case, folder: Path, rig: Any = None) -> Acquisition:
    """Return the inputs of the stages; a rig only for captures."""
    camera, projector = case.domains
    rays = camera.shape, projector.shape, case.channels
    plan = Plan.of(case.method, case.method, rays, {"target_error": case.target})
    settings = AcquisitionSettings(
        target_error=case.target,
        symmetry_brackets=6 if plan.measures_symmetry else 0,
        progress=False,
    )
    storage, resources = FolderStorage(folder), Resources(_MEMORY_GIB)
    if rig is not None:
        return Acquisition(storage, settings, resources, GivenRig(rig), rig.sensor, plan=plan)
    if storage.exists(0, "merge"):
        plan = plan.for_measured_rig(storage)
    return Acquisition(storage, settings, resources, plan=plan)


def capture(case: Case, folder: Path, level: int) -> None:
    """Capture a level of the simulated rig."""
    LEVEL_STAGES["capture"](_acquisition(case, folder, _rig(case)), level)


def process(case: Case, folder: Path, stage: str, level: int) -> tuple[float, float]:
    """Run a stage; return processor seconds and the peak memory of this process in GiB."""
    if stage == "relight":
        _relight(case, folder)
    elif stage == "assemble":
        assemble.run(_acquisition(case, folder))
    else:
        LEVEL_STAGES[stage](_acquisition(case, folder), level)
    status = Path("/proc/self/status").read_text()
    peak = next(line for line in status.splitlines() if line.startswith("VmHWM"))
    return time.process_time(), int(peak.split()[1]) / 2**20


def _patterns(case: Case) -> Any:
    camera, projector = case.domains
    count = int(np.clip(2e7 // camera.size, 6, 18))
    return relighting_pictures(projector.shape, count, _SEED)


def _relight(case: Case, folder: Path) -> None:
    from rfpipe.transport import open_transport

    transport = open_transport(folder / "transport.zarr")
    np.save(folder / "relit.npy", transport.relight_batch(_patterns(case)))


def true_error(case: Case, folder: Path) -> float:
    """Compute the mean relative error of the relit pictures."""
    scene, relative = _scene(case), []
    for pattern, relit in zip(
        _patterns(case), np.load(folder / "relit.npy", mmap_mode="r"), strict=True
    ):
        truth = scene.apply(pattern[None])
        relative.append(errors(np.asarray(relit)[None], truth)[0])
    return float(np.mean(relative))


# --- measurement


def stages(case: Case, folder: Path) -> Iterator[dict[str, Any]]:
    """Acquire a case stage by stage; yield name, level and costs of each, and last the error."""
    spawn = multiprocessing.get_context("spawn")
    storage = FolderStorage(folder)
    with (
        ProcessPoolExecutor(1, mp_context=spawn) as rig,
        ProcessPoolExecutor(1, mp_context=spawn, max_tasks_per_child=1) as fresh,
    ):

        def run(stage: str, level: int = 0) -> dict[str, Any]:
            seconds, peak = fresh.submit(process, case, folder, stage, level).result()
            return {"stage": stage, "level": level, "processor_s": seconds, "peak_gib": peak}

        level = 0
        while True:
            yield run("schedule", level)
            if not storage.read_manifest(level, "schedule")["patterns"]:
                break
            rig.submit(capture, case, folder, level).result()
            for stage in ("merge", "normalize", "refine"):
                yield run(stage, level)
            level += 1
        yield run("assemble")
        yield run("relight")
        yield {"stage": "error", "error": rig.submit(true_error, case, folder).result()}


def measure(case: Case, folder: Path) -> dict[str, Any]:
    """Acquire a case, and return its row of the table."""
    rows = []
    for row in stages(case, folder):
        rows.append(row)
        print(", ".join(f"{key} {value:.4g}" if isinstance(value, float) else f"{key} {value}"
                        for key, value in row.items()), flush=True)  # fmt: skip
    table = pd.DataFrame(rows)
    storage, levels = FolderStorage(folder), int(table["level"].max())
    state = storage.open(levels - 1, "refine")[1]["state"]
    captured = [storage.read_manifest(level, "capture") for level in range(levels)]
    camera, projector = case.domains
    refine = table[table["stage"] == "refine"]
    return {
        "case": case.name,
        "method": case.method,
        "camera_rays": camera.size,
        "projector_rays": projector.size,
        "channels": case.channels,
        "target_percent": 100 * case.target,
        "patterns": sum(facts["patterns"] for facts in captured),
        "estimate_percent": 100 * state["rows"][-1]["estimated_error"],
        "error_percent": 100 * rows[-1]["error"],
        "processor_s": table["processor_s"].sum(),
        "refine_s": refine["processor_s"].sum(),
        "peak_gib": table["peak_gib"].max(),
        "refine_gib": refine["peak_gib"].max(),
        "relight_gib": table[table["stage"] == "relight"]["peak_gib"].max(),
        "transport_mb": sum(
            path.stat().st_size for path in (folder / "transport.zarr").rglob("*")
        ) / 1e6,
    }  # fmt: skip


def main() -> None:
    """Measure cases."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", nargs="+", choices=list(CASES))
    parser.add_argument("--size", type=image_size, help="of the camera's and the projector's image")
    parser.add_argument("--target", type=float, help="target error")
    parser.add_argument("--channels", type=int, choices=(1, 3))
    parser.add_argument("--views", type=image_size, help="rows x columns of views")
    parser.add_argument("--folder", type=Path, default=Path("results/bench/scale"))
    arguments = parser.parse_args()
    for name in arguments.cases:
        case = CASES[name]
        if arguments.size:
            case = replace(case, camera=arguments.size, projector=arguments.size)
        for option in ("target", "channels", "views"):
            if (value := getattr(arguments, option)) is not None:
                case = replace(case, **{option: value})
        folder = arguments.folder / name
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        row = measure(case, folder)
        before = [pd.read_csv(MEASURED)] if MEASURED.exists() else []
        table = pd.concat([*before, pd.DataFrame([row])])
        text = table.to_csv(index=False, float_format="%.4g", lineterminator="\n")
        write_atomically(MEASURED, text.encode())
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()
