"""``rfpipe calibrate``: what a rig is, and whether it is good enough, with a report always."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

__all__ = ["calibrate"]


def calibrate(
    rig: Annotated[Path, typer.Argument(metavar="RIG", help="A YAML file of a rig's settings.")],
    output: Annotated[
        Path, typer.Option(help="Folder of the calibration; steps that are done there stay.")
    ] = Path("calibration"),
    step: Annotated[
        list[str] | None,
        typer.Option(help="Do this step alone, those that it needs being done; may be repeated."),
    ] = None,
    again: Annotated[
        bool, typer.Option("--again", help="Do steps anew that are done, as after a move.")
    ] = False,
) -> None:
    """Calibrate a rig: what it sees, noise, responses, correspondence, rays, symmetry; a report.

    Steps that are done and good, for the same devices and settings, are not repeated; a whole
    calibration that is not good is done anew. The report is written whatever happens. Exit status
    1 when a step is not good, or could not be measured.
    """
    import logging
    from contextlib import suppress

    from rfpipe.calibration.folder import CalibrationFolder, calibrate_rig
    from rfpipe.config import load_rig_config
    from rfpipe.errors import StoreError
    from rfpipe.report.calibration import build_calibration_report
    from rfpipe.rigs.calibrated import faults_of
    from rfpipe.stages.jobs.progress import Progress

    logging.basicConfig(format="%(message)s")
    logging.getLogger("rfpipe").setLevel(logging.INFO)
    config = load_rig_config(rig)
    folder = CalibrationFolder(output)
    try:
        calibrate_rig(config, output, step, Progress, again=again)
    finally:
        with suppress(StoreError):  # nothing is done yet
            typer.echo(f"report: {build_calibration_report(folder)}")
    verdicts = folder.verdicts()
    if faults_of(verdicts):
        names = ", ".join(
            one["title"].lower()
            for one in verdicts.values()
            if one["standing"] in ("poor", "failed")
        )
        typer.echo(f"not good: {names}. rfpipe serve refuses such a rig", err=True)
        raise typer.Exit(1)
