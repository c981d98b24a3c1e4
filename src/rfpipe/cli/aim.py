"""``rfpipe aim``: what the camera sees, live in a browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

__all__ = ["aim"]


def aim(
    rig: Annotated[Path, typer.Argument(metavar="RIG", help="A YAML file of a rig's settings.")],
    port: Annotated[int, typer.Option(help="Port of the page; 0 takes a free one.")] = 8751,
) -> None:
    """See live what the camera sees, in a browser: frame, focus and choose exposures.

    Open the address that is printed, on this machine; from another one through an SSH tunnel
    (ssh -L 8751:127.0.0.1:8751 RIG). The page shows the scene with what is saturated in red, what
    is too dark in blue and the projector's outline; how sharp stripes are; and a bracket of
    exposures to paste into the rig's settings. Ctrl-C ends it, and gives the devices back.
    """
    import logging

    from rfpipe.calibration.folder import uncalibrated
    from rfpipe.config import load_rig_config
    from rfpipe.rigs.build import devices_from_config
    from rfpipe.server.aim import aim as run

    logging.basicConfig(format="%(message)s")
    config = uncalibrated(load_rig_config(rig))

    def say(address: str) -> None:
        typer.echo(f"open {address}")

    run(lambda: devices_from_config(config), config.calibrate.period_pixels, port, say)
