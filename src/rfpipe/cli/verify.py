"""``rfpipe verify``: damage in a run's folder, and the commands that repair it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rfpipe.text import counted

if TYPE_CHECKING:
    from rfpipe.storage.checking import CheckResult


def verify(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER",
            help="A run's folder, its results or a part of them, a calibration, a published folder "
            "or zip file with a manifest-sha256.txt, or a zip file of a transport; or the address "
            "(https://, s3://) of a published folder, of a transport, or of a bucket to which "
            "'rfpipe keep' copied results.",
        ),
    ] = Path("results"),
    mend: Annotated[
        bool,
        typer.Option(
            "--mend",
            help="Remove the manifests of damaged stages, so that the next run repeats these "
            "stages. Readable pictures are never removed.",
        ),
    ] = False,
) -> None:
    """Check every store, chunk, manifest and table, and print a repair command for each damage.

    The check reads all bytes and changes nothing without --mend. Repairs keep the captured
    pictures: the workflow repeats damaged stages from the stages before them, and captures only
    those patterns again whose pictures are damaged. A report is also checked for missing or blank
    figures and dead links. Exit status 1 if anything is damaged.
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
        runs = dict.fromkeys(command.rpartition(" && ")[2] for command in commands if command)
        typer.echo(f"removed {counted(len(removals), 'file')}; now run: {' && '.join(runs)}")
        return
    reports = (folder, folder / "report", folder / "results/report")
    pages = [report / "index.html" for report in reports]
    mistakes = [mistake for page in pages if page.is_file() for mistake in check_page(page)]
    for mistake in mistakes:
        typer.echo(mistake)
    if checked.findings or mistakes:
        raise typer.Exit(1)


def _print(folder: Path, checked: CheckResult, commands: list[str]) -> None:
    from rfpipe.store.places import as_address

    name = as_address(folder) or folder
    copy = "copy it again from its source; no stage of this run can make it"
    for finding, command in zip(checked.findings, commands, strict=True):
        typer.echo(f"{finding.path}: {finding.what}\n    mend: {command or copy}")
        if finding.repair.cost:
            typer.echo(f"    cost: {finding.repair.cost}")
    for note in checked.notes:
        typer.echo(f"note: {note}")
    amount = (
        f"{checked.stores} stores, {checked.manifests} manifests and {checked.files} other files, "
        f"{checked.bytes / 1e6:,.1f} MB"
    )
    if checked.unnamed:
        amount += f"; not read: {counted(len(checked.unnamed), 'file')} without a manifest"
    if not checked.findings:
        typer.echo(f"{name}: undamaged. {amount}")
        return
    typer.echo(f"\n{name}: {counted(len(checked.findings), 'finding')} in {amount}")
