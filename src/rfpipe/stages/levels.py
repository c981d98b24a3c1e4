"""A whole acquisition on files: stage after stage, level after level, in one job.

Each stage leaves its store and manifest, log and time in the level's folder, as if it ran alone. A
stage that finds its manifest, made from the same things, has nothing to do: a job that was stopped
goes on where it stopped, and one that runs again for changed settings or code does only what they
change.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter
from typing import Any

from rfpipe.methods import Method
from rfpipe.photometry.normalize import Mode
from rfpipe.stages import assemble, merge, normalize, refine, schedule, symmetry
from rfpipe.stages.capturing.sensors import read_sensor
from rfpipe.stages.folder import SYMMETRY, AcquisitionFolder
from rfpipe.stages.jobs.job import stage_log
from rfpipe.stages.jobs.workers import Resources
from rfpipe.stages.plan import Plan
from rfpipe.store import StoreLock
from rfpipe.units import NumberFormat

__all__ = ["run"]


def run(
    plan: Plan,
    folder: AcquisitionFolder,
    scene: str,
    capture: Callable[..., None],
    *,
    code: Mapping[str, str],
    capture_options: Mapping[str, Any],
    merge_options: Mapping[str, Any],
    normalization: Mode,
    number_format: NumberFormat,
    asymmetry: float,
    resources: Resources,
) -> None:
    """Acquire a scene by a method, or what is missing of it; ``transport.json`` comes last.

    Parameters
    ----------
    plan : Plan
    folder : AcquisitionFolder
    scene : str
        Name, kept with the transport.
    capture : callable
        ``capture(folder, level, **options)`` is the stage `rfpipe.stages.capture.run` or
        `rfpipe.stages.hardware.run` with its rig.
    code : mapping of str to str
        As `rfpipe.stages.jobs.code.acquisition_code`.
    capture_options, merge_options : mapping
        Keyword arguments of `rfpipe.stages.capture.run` and `rfpipe.stages.merge.run`;
        ``symmetry_frames`` are taken where the method asks for them.
    normalization : {"none", "per_channel", "total_energy"}
    number_format : {"float32", "uint16", "uint8"}
        Of the stored transport.
    asymmetry : float
        Error that taking the rig for a coaxial one may make, as `rfpipe.stages.symmetry.run`.
    resources : Resources

    Raises
    ------
    LockedError
        When another process works on the same acquisition, such as a job that outlived a
        workflow that was killed.
    RfpipeError
        As the stages; what is done is kept. `CaptureError`, too, when the method needs a coaxial
        rig and this is none.
    """
    expected = plan.method.expected_patterns(plan.camera, plan.projector, plan.options)
    if not plan.asks_symmetry:
        capture_options = {**capture_options, "symmetry_frames": 0}
    is_judged = capture_options.get("symmetry_frames", 0) > 0
    if plan.camera.shape != plan.projector.shape:
        plan.settle(plan.method.on_rig(coaxial=False))

    def refined(level: int) -> None:
        plan.carry(level + 1, refine.run(plan, folder, level, code["refine"], resources))

    def settled() -> Method[Any]:
        with _stage(folder.manifest(0, SYMMETRY)):
            found = symmetry.run(
                read_sensor(folder), folder,
                saturation_fraction=merge_options["saturation_fraction"], code=code["symmetry"],
                keep_raw=capture_options.get("keep_raw", True),
            )  # fmt: skip
            return found.judge(plan.method, plan.options, asymmetry)

    stages: dict[str, Callable[[int], None]] = {
        "schedule": lambda level: schedule.run(plan, folder, level, code["schedule"]),
        "capture": lambda level: capture(
            folder, level,
            **capture_options, expected_patterns=expected, resources=resources.here,
        ),
        "merge": lambda level: merge.run(
            read_sensor(folder), folder, level,
            **merge_options, code=code["merge"], resources=resources,
        ),
        "normalize": lambda level: normalize.run(
            plan, folder, level, mode=normalization, code=code["normalize"]
        ),
        "refine": refined,
    }  # fmt: skip
    with StoreLock(folder.path):
        level = 0
        while level < plan.n_levels:
            for name, stage in stages.items():
                with _stage(folder.manifest(level, name)):
                    stage(level)
                if is_judged and level == 0 and name == "merge":
                    plan.settle(settled())
            level += 1
        manifest = folder.path / "transport.json"
        with _stage(manifest):
            assemble.run(plan, folder, manifest, scene, number_format, code["assemble"])


@contextmanager
def _stage(manifest: Path) -> Iterator[None]:
    """Keep a stage's log beside its manifest, and its seconds where it did any work."""
    store = manifest.with_suffix(".zarr")
    before, began = _stamp(store), perf_counter()
    with stage_log(manifest.with_suffix(".log")):
        yield
    if _stamp(store) != before:
        times = manifest.with_suffix(".benchmark.tsv")
        times.write_text(f"s\n{perf_counter() - began:.4f}\n", encoding="ascii")


def _stamp(store: Path) -> tuple[int, int] | None:
    """Return what changes when files of a store are written or the store is replaced."""
    try:
        status = store.stat()
    except FileNotFoundError:
        return None
    return status.st_ino, status.st_mtime_ns
