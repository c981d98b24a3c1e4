"""The report of a run in which some acquisitions failed."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from rfpipe.config import Config
from rfpipe.report.build import build_report
from rfpipe.stages import evaluate


def build_report_of_others(
    config: Config, results: Path, failed: Iterable[tuple[str, str]]
) -> Path | None:
    """Write the report of all acquisitions except those that failed, and name these in it.

    Parameters
    ----------
    config : Config
        Settings of the run.
    results : Path
        What its stages left.
    failed : iterable of (str, str)
        Scene and method of each acquisition that failed.

    Returns
    -------
    Path or None
        The page; None where no other acquisition is relit.
    """
    failed = list(failed)
    others = _without(config, results, set(failed))
    if others is None:
        return None
    page = results / "report" / "index.html"
    tables = [page.parent / "tables" / f"{name}.csv" for name in ("errors", "speed_error")]
    relit = [results / scene / name / "relight.json" for scene, name in others.acquisitions]
    for table in tables:
        table.parent.mkdir(parents=True, exist_ok=True)
    evaluate.run(relit, tables[0], tables[1], others.capture.seconds_per_pattern)
    names = ", ".join(f"{scene} by {method}" for scene, method in failed)
    note = f"Left out, since a stage failed: {names}."
    build_report(others, results, page, tables[0], tables[1], note)
    return page


def _without(config: Config, results: Path, failed: set[tuple[str, str]]) -> Config | None:
    """Settings of the relit acquisitions that didn't fail; None for no acquisition."""
    scenes = {}
    for scene, settings in config.scenes.items():
        methods = {
            method: options
            for method, options in config.methods_of(scene).items()
            if (scene, method) not in failed
            and (results / scene / method / "relight.json").exists()
        }
        if methods:
            scenes[scene] = settings.model_copy(update={"methods": methods})
    return config.model_copy(update={"scenes": scenes}) if scenes else None
