"""``rfpipe verify``: what is wrong in a run's folder, and the command that mends it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rfpipe.storage.checking import Checked


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
) -> None:
    """Check every store, chunk, manifest and table, and name the command that mends each finding.

    All bytes are read, and nothing is changed without --mend. What was captured is kept: the
    workflow makes damaged stages anew from those before them, and shows only those patterns again
    whose pictures are damaged. Of a report it is checked, too, that no figure is missing or blank
    and no link leads to nothing. Exit status 1 when anything is wrong.
    """
    from tqdm import tqdm

    from rfpipe.report.page import check_page
    from rfpipe.storage.checking import check
    from rfpipe.storage.repairs import command_for

    with tqdm(unit="B", unit_scale=True, leave=False, disable=None) as bar:
        checked = check(folder, bar.update)
    commands = [command_for(finding) for finding in checked.findings]
    _print(folder, checked, commands)
    removals = checked.removals()
    if mend and removals:
        from rfpipe.store.files import remove_tree

        for path in removals:
            remove_tree(path)
        again = dict.fromkeys(command.rpartition(" && ")[2] for command in commands if command)
        typer.echo(f"removed what has to go ({len(removals)}); now run: {' && '.join(again)}")
        return
    pages = [
        place / "index.html" for place in (folder, folder / "report", folder / "results/report")
    ]
    faults = [fault for page in pages if page.is_file() for fault in check_page(page)]
    for fault in faults:
        typer.echo(fault)
    if checked.findings or faults:
        raise typer.Exit(1)


def _print(folder: Path, checked: Checked, commands: list[str]) -> None:
    from rfpipe.store.places import as_address

    named = as_address(folder) or folder
    copy = "copy it again from where it came from; nothing here can make it anew"
    for finding, command in zip(checked.findings, commands, strict=True):
        typer.echo(f"{finding.path}: {finding.what}\n    mend: {command or copy}")
        if finding.mend.cost:
            typer.echo(f"    cost: {finding.mend.cost}")
    for note in checked.notes:
        typer.echo(f"note: {note}")
    amount = (
        f"{checked.stores} stores, {checked.manifests} manifests and {checked.files} other files, "
        f"{checked.bytes / 1e6:,.1f} MB"
    )
    if checked.unnamed:
        amount += f"; not read: {len(checked.unnamed)} that no manifest names"
    if not checked.findings:
        typer.echo(f"{named}: whole. {amount}")
        return
    count = len(checked.findings)
    typer.echo(f"\n{named}: {count} {'finding' if count == 1 else 'findings'} in {amount}")
