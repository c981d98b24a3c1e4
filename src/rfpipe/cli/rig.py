"""``rfpipe aim``, ``calibrate`` and ``serve``: setting up and running a rig."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

RigFile = Annotated[
    Path, typer.Argument(metavar="RIG", help="Settings file of a rig, such as config/rig.yaml.")
]


def aim(
    rig: RigFile,
    port: Annotated[int, typer.Option(help="Port of the page; 0 for any free port.")] = 8751,
) -> None:
    """Show the camera's live image in a browser, to frame the scene, focus and choose exposures.

    Open the printed address on this machine, or on another one through an SSH tunnel
    (ssh -L 8751:127.0.0.1:8751 RIG). The page shows the scene, with saturated pixels in red, pixels
    that are too dark in blue, and the outline of the projector's picture; the sharpness of
    projected stripes; a bracket of exposures for the rig's settings; and, measured after every
    tenth look, the projector's delay, frames that are lost or repeated, and the flicker in each
    exposure. Ctrl-C ends the program and releases the devices, which 'rfpipe calibrate' and 'rfpipe
    serve' need.
    """
    import logging

    from rfpipe.config import load_rig_config
    from rfpipe.installation import needing
    from rfpipe.rigs.build import devices_from_config

    with needing("rig", "rfpipe aim"):
        from rfpipe.server.aim import aim as run

    logging.basicConfig(format="%(message)s")
    config = load_rig_config(rig).model_copy(update={"calibration": None})

    def print_address(address: str) -> None:
        typer.echo(f"open {address}; end with Ctrl-C")

    run(lambda: devices_from_config(config), config.calibrate.period_pixels, port, print_address)
    typer.echo("stopped; the devices are free for rfpipe calibrate")


def calibrate(
    rig: RigFile,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="Folder of the calibration; by default the rig's setting calibration.",
        ),
    ] = None,
    step: Annotated[
        list[str] | None,
        typer.Option(
            help="Do only this step; the steps on which it depends must be done. May be repeated."
        ),
    ] = None,
    repeat: Annotated[
        bool,
        typer.Option("--again", help="Repeat steps that are done, such as after moving the rig."),
    ] = False,
) -> None:
    """Calibrate a rig: view, noise, responses, correspondence, rays and symmetry; write a report.

    Steps with good results for the same devices and settings are not repeated. If a setting
    changed, the steps that depend on it are. A complete calibration with poor results is repeated
    as a whole. The report is written in any case. Exit status 1 if a step had a poor result or
    failed.
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
        calibrate_rig(config, path, step, Progress, repeat=repeat)
        is_complete = True
    finally:
        if is_complete or folder.written_at() != before:
            typer.echo(f"report: {build_calibration_report(folder)}")
    verdicts = folder.verdicts().values()
    bad = [verdict for verdict in verdicts if verdict["standing"] in ("poor", "failed")]
    if bad:
        results = "; ".join(f"{step['title']}: {STANDINGS[step['standing']]}" for step in bad)
        typer.echo(f"{results}. rfpipe serve refuses such a rig", err=True)
        raise typer.Exit(1)
    if config.calibration is None or Path(config.calibration) != path:
        current = config.calibration or "null"
        typer.echo(
            f"{rig} has calibration: {current}; to use the new one, set calibration: {path}",
            err=True,
        )


def serve(
    rig: RigFile,
    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port to listen on; 0 for any free port.")
    ] = 8750,
    allow_remote: Annotated[
        bool,
        typer.Option(
            "--allow-remote", help="Allow other machines to connect; an SSH tunnel is safer."
        ),
    ] = False,
    token_file: Annotated[
        Path | None,
        typer.Option(
            help="File with the token, readable only by you; by default, the environment "
            "variable RFPIPE_TOKEN."
        ),
    ] = None,
    lease_seconds: Annotated[
        float,
        typer.Option(min=0.5, help="Seconds after which a silent client loses the rig."),
    ] = 15.0,
    force: Annotated[
        bool,
        typer.Option("--force", help="Serve a rig whose calibration is poor or outdated."),
    ] = False,
) -> None:
    """Run the acquisition server, next to a rig's devices, until Ctrl-C or SIGTERM.

    The server refuses a rig with a poor calibration, or with settings that changed after the
    calibration: repair it and calibrate again, or use --force. Other machines connect over
    unencrypted HTTP; an SSH tunnel is safer.
    """
    from rfpipe.config import load_rig_config
    from rfpipe.installation import needing
    from rfpipe.rigs.build import rig_from_config
    from rfpipe.rigs.calibrated import calibration_of, check_verdicts
    from rfpipe.rigs.messages import read_token
    from rfpipe.server import ServerSettings

    with needing("rig", "rfpipe serve"):
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
