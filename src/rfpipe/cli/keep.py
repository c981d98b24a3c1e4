"""``rfpipe keep``: a run's results in a bucket of an object store."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

__all__ = ["keep"]


def keep(
    folder: Annotated[
        Path,
        typer.Argument(metavar="FOLDER", help="A run's folder, in which its 'results' lie."),
    ],
    address: Annotated[
        str,
        typer.Argument(metavar="ADDRESS", help="Of this run alone: s3://bucket/folder."),
    ],
) -> None:
    """Bring a run's transports, relit pictures and report into a bucket; captures stay here.

    What is there already isn't sent again, and an upload that was interrupted goes on: run it
    again. Credentials come from the environment: AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY,
    AWS_REGION and, for servers other than Amazon's, AWS_ENDPOINT_URL. Read what is there with
    rfpipe.open_transport("s3://..."), rfpipe relight and rfpipe verify. A run whose settings have
    storage.keep_at does this by itself, at its end.
    """
    from rfpipe.publish import find_run
    from rfpipe.publish import keep as bring

    kept = bring(find_run(folder), address, lambda name: typer.echo(f"  {name}", err=True))
    typer.echo(
        f"{kept.address}: {kept.objects:,} objects, {kept.nbytes / 1e6:,.1f} MB; sent "
        f"{kept.sent:,} of them, {kept.nbytes_sent / 1e6:,.1f} MB"
    )
    typer.echo(f"check: rfpipe verify {kept.address}")
