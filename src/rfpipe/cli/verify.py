"""``rfpipe verify``: what is wrong in a run's folder, and the command that mends it."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from rfpipe.stages.checking.stores import Checked, Finding

__all__ = ["verify"]


def verify(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER",
            help="A run's folder, its results or a part of them, a calibration, or a published "
            "folder or zip with a manifest-sha256.txt, or a zip of a transport; or an address "
            "(https://, s3://) of such a folder, of what 'rfpipe keep' brought into a bucket, or "
            "of a transport.",
        ),
    ] = Path("results"),
    mend: Annotated[
        bool,
        typer.Option(
            "--mend",
            help="Remove what has to go for the next run to make it anew: damaged stages' "
            "manifests, and no picture that can still be read.",
        ),
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the findings as JSON, for other programs.")
    ] = False,
) -> None:
    """Check every store, chunk, manifest and table, and name the command that mends each finding.

    All bytes are read, and nothing is changed without --mend. What was captured is kept: the
    workflow makes damaged stages anew from those before them, and shows only those patterns again
    whose pictures are damaged. Of a report it is checked, too, that no figure is missing or blank
    and no link leads to nothing. Exit status 1 when anything is wrong.
    """
    from rfpipe.stages.checking.run import bytes_below, check, command_for

    if sys.stderr.isatty() and folder.is_dir():
        from tqdm import tqdm

        with tqdm(total=bytes_below(folder), unit="B", unit_scale=True, leave=False) as bar:
            checked = check(folder, bar.update)
    else:
        checked = check(folder)
    if as_json:
        typer.echo(json.dumps(_plain(folder, checked), indent=2))
    else:
        _print(folder, checked)
    removals = checked.removals()
    if mend and removals:
        from rfpipe.store.files import remove_tree

        for path in removals:
            remove_tree(path)
        agains = dict.fromkeys(command_for(each).rpartition(" && ")[2] for each in checked.findings)
        again = " && ".join(filter(None, agains))
        typer.echo(f"removed {len(removals)} files and folders; now run: {again}", err=as_json)
        return
    pages = [
        place / "index.html" for place in (folder, folder / "report", folder / "results/report")
    ]
    faults = [fault for page in pages if page.is_file() for fault in _page_faults(page)]
    for fault in faults:
        typer.echo(fault, err=as_json)
    if checked.findings or faults:
        raise typer.Exit(1)


def _page_faults(page: Path) -> list[str]:
    from rfpipe.report import check_page

    return check_page(page)


def _print(folder: Path, checked: Checked) -> None:
    from rfpipe.store.places import as_address

    named = as_address(folder) or folder
    for finding in checked.findings:
        typer.echo(f"{finding.path}: {finding.what}")
        for line in _advice(finding):
            typer.echo(f"    {line}")
    for note in checked.notes:
        typer.echo(f"note: {note}")
    amount = (
        f"{checked.stores} stores, {checked.manifests} manifests and {checked.files} other files, "
        f"{checked.bytes / 1e6:,.1f} MB"
    )
    if not checked.findings:
        typer.echo(f"{named}: whole. {amount}")
        return
    typer.echo(f"\n{named}: {len(checked.findings)} findings in {amount}")
    if len(checked.findings) > 1 and checked.removals():
        typer.echo(
            "All at once: rfpipe verify FOLDER --mend removes what these commands remove, and says "
            "what to run."
        )


def _advice(finding: Finding) -> list[str]:
    from rfpipe.stages.checking.run import command_for

    command = command_for(finding)
    if not command:
        return ["mend: copy it again from where it came from; nothing here can make it anew"]
    return [f"mend: {command}", *([f"cost: {finding.mend.cost}"] if finding.mend.cost else [])]


def _plain(folder: Path, checked: Checked) -> dict[str, Any]:
    from rfpipe.stages.checking.run import command_for

    return {
        "folder": str(folder),
        "whole": not checked.findings,
        "stores": checked.stores,
        "manifests": checked.manifests,
        "files": checked.files,
        "bytes": checked.bytes,
        "notes": checked.notes,
        "findings": [
            {
                "path": str(finding.path),
                "what": finding.what,
                "mend": command_for(finding) or None,
                "cost": finding.mend.cost or None,
            }
            for finding in checked.findings
        ],
    }
