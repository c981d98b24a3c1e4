"""``rfpipe patterns`` and ``rfpipe import``: acquisitions with an offline rig."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rfpipe.cli.arguments import ConfigFile
from rfpipe.text import counted

if TYPE_CHECKING:
    from rfpipe.rigs.offline import Sheet
    from rfpipe.stages.offline import OfflineAcquisition


def patterns(
    config: ConfigFile,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder for the sheets, one subfolder per sheet.")
    ] = Path("patterns"),
    results: Annotated[Path, typer.Option(help="Folder of the run's results.")] = Path("results"),
) -> None:
    """Write the next patterns as image files, for a projector and camera without drivers.

    For each scene and method, the command writes a sheet: a folder of PNG files at the projector's
    resolution, numbered in the order of display, and patterns.json, which describes each file.

    Display the files one by one, and take a bracket of each: its exposures in any order, or first
    all pictures at one exposure, then all at the next. Put the pictures into the sheet's folder
    'pictures'. Then 'rfpipe import' reads them and writes the next sheet, until the acquisition
    has all pictures. Pictures that were imported are not needed again.
    """
    from rfpipe.config import load_config
    from rfpipe.output import checked_output
    from rfpipe.stages.offline import OfflineAcquisition

    checked_output("patterns", output)
    settings = load_config(config)
    for scene, name in settings.acquisitions:
        acquisition = OfflineAcquisition(settings, scene, name, results / scene / name)
        rig = acquisition.rig()
        level = acquisition.advance(rig)
        sheet = None
        if level is not None:
            sheet = acquisition.write(rig, level, output, config, results)
        _print_next_step(f"{scene} by {name}", sheet, results / scene / name, config)


def import_(
    folder: Annotated[
        Path,
        typer.Argument(metavar="FOLDER", help="Folder of a sheet from 'rfpipe patterns'."),
    ],
    pictures: Annotated[
        Path | None,
        typer.Option(help="Folder of the pictures; by default 'pictures' in the sheet's folder."),
    ] = None,
    anyway: Annotated[
        bool, typer.Option("--anyway", help="Import pictures even if a check finds mistakes.")
    ] = False,
    take_back: Annotated[
        bool,
        typer.Option(
            "--take-back",
            help="Undo the import of this sheet and of all later ones instead.",
        ),
    ] = False,
) -> None:
    """Import the pictures of a sheet's patterns, continue the acquisition, write the next sheet.

    The pictures are TIFF, PNG, EXR or raw files. Sorted by the numbers in their names, they are in
    the order in which they were taken, with the exposures of a bracket together.

    All pictures are checked before the first is imported: their number, size, channels, bits,
    exposure times (if the files contain them) and saturation, their order by the marker frames,
    and whether each picture shows its pattern. --take-back undoes an import and all that followed
    from it; the picture files stay.
    """
    from rfpipe.config import load_config
    from rfpipe.errors import CaptureError
    from rfpipe.pictures import picture_files
    from rfpipe.rigs.offline import PICTURES, read_sheet, run_paths
    from rfpipe.stages.offline import OfflineAcquisition

    sheet = read_sheet(folder)
    config, results = run_paths(sheet)
    scene, name, level_of_sheet = (sheet.about[key] for key in ("scene", "method", "level"))
    acquisition = OfflineAcquisition(load_config(config), scene, name, results / scene / name)
    if take_back:
        picture_files(pictures or folder / PICTURES)  # raises if the only copies are gone
        _take_back(acquisition, sheet)
        return
    checked = acquisition.read(sheet, pictures or folder / PICTURES, anyway=anyway)
    for note in checked.notes:
        typer.echo(f"{folder}: {note}", err=True)
    rig, is_new = checked.rig, not acquisition.files.exists(level_of_sheet, "capture")
    try:
        level = acquisition.advance(rig)
    except CaptureError as error:
        if not is_new:
            raise
        acquisition.take_back(level_of_sheet)
        raise CaptureError(f"{error}. None of these pictures was imported") from error
    state = "imported" if is_new else "imported before; to import others, first use --take-back"
    typer.echo(f"{folder}: {counted(len(checked.files), 'bracket')} {state}")
    next_sheet = None
    if level is not None:
        next_sheet = acquisition.write(rig, level, folder.parent, config, results)
    _print_next_step(f"{scene} by {name}", next_sheet, results / scene / name, config)


def _take_back(acquisition: OfflineAcquisition, sheet: Sheet) -> None:
    """Remove the results of a sheet's pictures, and the sheets that follow from them."""
    from rfpipe.rigs.offline import PICTURES, later_sheets, remove_sheet

    for path in acquisition.take_back(sheet.about["level"]):
        typer.echo(f"{path}: removed")
    for later in later_sheets(sheet):
        if remove_sheet(later):
            typer.echo(f"{later.folder}: removed")
        else:
            typer.echo(
                f"{later.folder / PICTURES}: contains pictures of patterns that may change; move "
                "them away",
                err=True,
            )
    typer.echo(f"{sheet.folder}: import undone. Correct the pictures and import them again")


def _print_next_step(acquisition: str, sheet: Sheet | None, folder: Path, config: Path) -> None:
    """Print the user's next step: pictures to take, or the command for the report."""
    from rfpipe.storage.base import level_name

    if sheet is None:
        home, settings = str(folder.absolute().parents[2]), str(config.absolute())
        run = [sys.argv[0], "run", "--directory", home, "--configfile", settings]
        typer.echo(
            f"{acquisition}: complete; the transport is {folder / 'transport.zarr'}. For the "
            f"report: {shlex.join(run)}"
        )
        return
    level = level_name(sheet.about["level"])
    times = ", ".join(f"{seconds:g}" for seconds in sheet.exposures_s)
    typer.echo(
        f"{acquisition}: {level} has {counted(len(sheet.shown) - 3, 'pattern')} and 3 markers. "
        f"Display {sheet.folder}/*.png in order, take exposures of {times} s of each, put the "
        f"pictures into {sheet.folder / 'pictures'}, then: "
        f"{shlex.join([sys.argv[0], 'import', str(sheet.folder)])}"
    )
