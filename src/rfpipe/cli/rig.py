"""``rfpipe aim``, ``calibrate`` and ``serve``: a rig, from its devices to its server."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

RigFile = Annotated[
    Path, typer.Argument(metavar="RIG", help="A YAML file of a rig's settings: config/rig.yaml.")
]


def aim(
    rig: RigFile,
    port: Annotated[int, typer.Option(help="Port of the page; 0 takes a free one.")] = 8751,
) -> None:
    """See live what the camera sees, in a browser: frame, focus and choose exposures.

    Open the address that is printed, on this machine; from another one through an SSH tunnel
    (ssh -L 8751:127.0.0.1:8751 RIG). The page shows the scene with what is saturated in red, what
    is too dark in blue and the projector's outline; how sharp stripes are; and a bracket of
    exposures to paste into the rig's settings. Ctrl-C ends it, and gives the devices back: end it
    before 'rfpipe calibrate' or 'serve', which need them.
    """
    import logging

    from rfpipe.config import load_rig_config
    from rfpipe.rigs.build import devices_from_config
    from rfpipe.server.aim import aim as run

    logging.basicConfig(format="%(message)s")
    config = load_rig_config(rig).model_copy(update={"calibration": None})

    def say(address: str) -> None:
        typer.echo(f"open {address}; Ctrl-C here ends it")

    run(lambda: devices_from_config(config), config.calibrate.period_pixels, port, say)
    typer.echo("stopped; the devices are free for rfpipe calibrate")


def calibrate(
    rig: RigFile,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="Folder of the calibration; by default that of the rig's setting calibration.",
        ),
    ] = None,
    step: Annotated[
        list[str] | None,
        typer.Option(help="Do this step alone, those that it needs being done; may be repeated."),
    ] = None,
    again: Annotated[
        bool, typer.Option("--again", help="Do steps anew that are done, as after a move.")
    ] = False,
) -> None:
    """Calibrate a rig: what it sees, noise, responses, correspondence, rays, symmetry; a report.

    Steps that are done and good, for the same devices and settings, are not repeated; where a
    setting changed, the steps that it concerns are. A whole calibration that is not good is
    repeated. The report is written whatever happens. Exit status 1 when a step is not good, or
    could not be measured.
    """
    import logging

    from rfpipe.calibration.folder import CalibrationFolder
    from rfpipe.calibration.run import calibrate_rig
    from rfpipe.config import load_rig_config
    from rfpipe.jobs.job import Progress
    from rfpipe.output import check_folder, check_no_run, checked_output
    from rfpipe.report.calibration import build_calibration_report
    from rfpipe.rigs.calibrated import STANDINGS

    logging.basicConfig(format="%(message)s")
    logging.getLogger("rfpipe").setLevel(logging.INFO)
    config = load_rig_config(rig)
    if output is not None:
        checked_output("calibrate", output)
    path = output or Path(config.calibration or "calibration")
    check_folder(path)
    check_no_run(path, "steps")
    folder = CalibrationFolder(path)
    before, is_complete = folder.written_at(), False
    try:
        calibrate_rig(config, path, step, Progress, repeat=again)
        is_complete = True
    finally:
        if is_complete or folder.written_at() != before:
            typer.echo(f"report: {build_calibration_report(folder)}")
    bad = [one for one in folder.verdicts().values() if one["standing"] in ("poor", "failed")]
    if bad:
        names = "; ".join(f"{one['title']}: {STANDINGS[one['standing']]}" for one in bad)
        typer.echo(f"{names}. rfpipe serve refuses such a rig", err=True)
        raise typer.Exit(1)
    if config.calibration is None or Path(config.calibration) != path:
        named = config.calibration or "null"
        typer.echo(
            f"{rig} has calibration: {named}; to use this one, set it to calibration: {path}",
            err=True,
        )


def serve(
    rig: RigFile,
    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port to listen on; 0 takes a free one.")
    ] = 8750,
    allow_remote: Annotated[
        bool,
        typer.Option("--allow-remote", help="Let other machines connect; a tunnel is safer."),
    ] = False,
    token_file: Annotated[
        Path | None,
        typer.Option(help="File of the token, readable by you alone; else RFPIPE_TOKEN."),
    ] = None,
    lease_seconds: Annotated[
        float,
        typer.Option(min=0.5, help="Seconds that a client keeps the rig without a sign of life."),
    ] = 15.0,
    force: Annotated[
        bool,
        typer.Option("--force", help="Serve a rig whose calibration is not good or outdated."),
    ] = False,
) -> None:
    """Run the acquisition server, next to a rig's devices, until Ctrl-C or SIGTERM.

    A rig whose calibration found faults, or whose settings changed afterwards, is refused: mend it
    and calibrate again, or say --force. Other machines are served over plain HTTP: an SSH tunnel is
    safer.
    """
    from rfpipe.config import load_rig_config
    from rfpipe.rigs.build import rig_from_config
    from rfpipe.rigs.calibrated import calibration_of, check_verdicts
    from rfpipe.rigs.messages import read_token
    from rfpipe.server import ServerSettings
    from rfpipe.server.run import serve as run

    settings = ServerSettings(
        host=host,
        port=port,
        allow_remote=allow_remote,
        lease_seconds=lease_seconds,
    )
    config = load_rig_config(rig)
    if config.kind == "devices" and config.rig is None:
        check_verdicts(calibration_of(config).facts, config.calibration, force=force)
    run(lambda: rig_from_config(config, str(rig), force=force), read_token(token_file), settings)
