"""The code behind a stage's result: what its module imports, so that an edit of it counts."""

from __future__ import annotations

from functools import cache

from rfpipe.plugins import path_of
from rfpipe.provenance import import_fingerprint, imported_sources

__all__ = [
    "CHOOSING",
    "MERGED_WITH",
    "SHAPELESS",
    "acquisition_code",
    "module_of",
    "stage_code",
    "stage_modules",
]

CHOOSING = ("rfpipe",)
"""Modules that import one of many by name; the one that is chosen counts, the others don't."""

SHAPELESS = (
    "rfpipe.config",
    "rfpipe.errors",
    "rfpipe.plugins",
    "rfpipe.stages.jobs.cluster",
    "rfpipe.stages.jobs.job",
    "rfpipe.stages.jobs.processes",
    "rfpipe.stages.jobs.progress",
    "rfpipe.stages.jobs.sent",
    "rfpipe.stages.jobs.workers",
)
"""Modules that shape no result: they say what happens, or where, check settings whose values a
stage is given and made from, or find what is named, which counts itself."""

MERGED_WITH = "rfpipe.stages.capturing.sensors"
"""What finds the sensor, with which `rfpipe.stages.merge.run` is called."""


@cache
def stage_code(stage: str, *chosen: str) -> str:
    """Fingerprint of the code that shapes a stage's result, without importing it.

    Found once in a process.

    Parameters
    ----------
    stage : str
        Dotted name of its module below rfpipe, such as "stages.merge".
    chosen : str
        Modules, or Python files, that the stage imports by a name from the configuration.

    Raises
    ------
    InputError
        When one of them has no Python sources.
    """
    return import_fingerprint(f"rfpipe.{stage}", *chosen, choosing=CHOOSING, without=SHAPELESS)


def acquisition_code(method: str) -> dict[str, str]:
    """Fingerprints of the code behind each stage of an acquisition, as `rfpipe.stages.levels.run`.

    Captures have none: what a rig took is never thrown away by an edit of the code.

    Parameters
    ----------
    method : str
        Module, or Python file, of the method.
    """
    of_method = ("schedule", "normalize", "refine", "assemble")
    return {
        "merge": stage_code("stages.merge", MERGED_WITH),
        "symmetry": stage_code("stages.symmetry", MERGED_WITH),
        "verification": stage_code("stages.unseen.comparing"),
        **{stage: stage_code(f"stages.{stage}", method) for stage in of_method},
    }


def stage_modules(stage: str, *chosen: str) -> list[str]:
    """Names of the modules of which `stage_code` is the fingerprint; arguments as there."""
    return list(imported_sources(f"rfpipe.{stage}", *chosen, choosing=CHOOSING, without=SHAPELESS))


def module_of(group: str, name: str) -> str:
    """Module, or Python file, of what a name or path stands for, to give to `stage_code`.

    `group` is one of those in `rfpipe.plugins`.
    """
    return path_of(group, name).rpartition(":")[0]
