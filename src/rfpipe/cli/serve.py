"""``rfpipe serve``: the acquisition server of a rig."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def serve(
    rig: Annotated[
        Path, typer.Argument(metavar="RIG.yaml", help="The rig's settings; see config/rig.yaml.")
    ],
    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port to listen on; 0 takes a free one.")
    ] = 8750,
    allow_remote: Annotated[
        bool,
        typer.Option(
            "--allow-remote",
            help="Let other machines connect, over plain HTTP: an SSH tunnel is safer.",
        ),
    ] = False,
    token_file: Annotated[
        Path | None,
        typer.Option(
            help="File with the token that clients must send, readable by you alone; without it, "
            "the environment variable RFPIPE_TOKEN."
        ),
    ] = None,
    lease_seconds: Annotated[
        float,
        typer.Option(min=0.5, help="Seconds that a client keeps the rig without a sign of life."),
    ] = 15.0,
    log_file: Annotated[Path | None, typer.Option(help="File to log to beside stderr.")] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Serve a rig whose calibration is not good, too.")
    ] = False,
) -> None:
    """Run the acquisition server, next to a rig's devices, until Ctrl-C or SIGTERM.

    A rig whose calibration found faults is refused: mend it, or say --force.
    """
    from rfpipe.config import load_rig_config
    from rfpipe.rigs.build import rig_from_config
    from rfpipe.rigs.calibrated import calibration_of, check_verdicts
    from rfpipe.rigs.protocol import read_token
    from rfpipe.server import ServerSettings
    from rfpipe.server.run import serve as run

    settings = ServerSettings(
        host=host,
        port=port,
        allow_remote=allow_remote,
        lease_seconds=lease_seconds,
        log_file=log_file,
    )
    config = load_rig_config(rig)
    if config.kind == "devices" and config.rig is None:
        check_verdicts(calibration_of(config).facts, config.calibration, force=force)
    run(lambda: rig_from_config(config), read_token(token_file), settings)
