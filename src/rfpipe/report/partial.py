"""Report of a run in which some acquisitions failed."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from rfpipe.config import Config
from rfpipe.report.build import build_report
from rfpipe.stages import evaluate


def build_partial_report(
    config: Config, results: Path, failed: Iterable[tuple[str, str]]
) -> Path | None:
    """Write the report of all relit acquisitions except failed ones, which it names.

    Parameters
    ----------
    config : Config
        Settings of the run.
    results : Path
        Folder of results.
    failed : iterable of (str, str)
        Scene and method of each acquisition that failed.

    Returns
    -------
    Path or None
        The page; None if no other acquisition is relit.
    """
    failed = list(failed)
    remaining = _without(config, results, set(failed))
    if remaining is None:
        return None
    page = results / "report" / "index.html"
    tables = [page.parent / "tables" / f"{name}.csv" for name in ("errors", "speed_error")]
    relit = [results / scene / name / "relight.json" for scene, name in remaining.acquisitions]
    for table in tables:
        table.parent.mkdir(parents=True, exist_ok=True)
    evaluate.run(relit, tables[0], tables[1], remaining.capture.seconds_per_pattern)
    names = ", ".join(f"{scene} by {method}" for scene, method in failed)
    note = f"Without acquisitions in which a stage failed: {names}."
    build_report(remaining, results, page, tables[0], tables[1], note)
    return page


def _without(config: Config, results: Path, failed: set[tuple[str, str]]) -> Config | None:
    """Return the settings of the relit acquisitions that didn't fail; None if there are none."""
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
