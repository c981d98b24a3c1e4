"""``rfpipe patterns`` and ``rfpipe import``: acquisitions whose pictures are taken elsewhere."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rfpipe.cli.run import ConfigFile
from rfpipe.text import counted

if TYPE_CHECKING:
    from rfpipe.rigs.offline import Sheet
    from rfpipe.stages.offline import OfflineAcquisition


def patterns(
    config: ConfigFile,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder of the sheets; each has one in it.")
    ] = Path("patterns"),
    results: Annotated[Path, typer.Option(help="Of the run, there or to come.")] = Path("results"),
) -> None:
    """Write the pictures that a projector is to show next, where the pictures are taken elsewhere.

    For each scene and method a sheet, a folder of PNGs at the projector's resolution, numbered in
    the order of showing, with patterns.json, which names each. Take a bracket of each picture, all
    of one exposure after the other or in any order within a bracket, and lay the files into the
    sheet's folder 'pictures'; then 'rfpipe import' reads them, and writes the next sheet, until
    nothing is asked for. What is captured already isn't asked for again.
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
        sheet = None if level is None else acquisition.write(rig, output, config, results)
        _tell(f"{scene} by {name}", sheet, results / scene / name, config)


def import_(
    folder: Annotated[
        Path,
        typer.Argument(metavar="FOLDER", help="A sheet's folder, as 'rfpipe patterns' wrote it."),
    ],
    pictures: Annotated[
        Path | None,
        typer.Option(help="Folder of the pictures; 'pictures' in the sheet's folder by default."),
    ] = None,
    anyway: Annotated[
        bool, typer.Option("--anyway", help="Take pictures that seem wrong.")
    ] = False,
    take_back: Annotated[
        bool, typer.Option("--take-back", help="Remove what was imported from here on, instead.")
    ] = False,
) -> None:
    """Read the pictures that were taken of a sheet's patterns, go on, and write the next sheet.

    Pictures are TIFF, PNG, EXR or raw files, which sort by the numbers in their names as they were
    taken, a bracket's exposures together. All are checked before any is kept: number, size,
    channels, bits, exposure times where the files say them, saturation, order by the marker frames,
    and whether each picture shows its pattern. A sheet that was imported can be taken back, with
    all that followed from it; its pictures stay.
    """
    from rfpipe.config import load_config
    from rfpipe.errors import CaptureError
    from rfpipe.pictures import picture_files
    from rfpipe.rigs.offline import PICTURES, read_sheet, run_paths
    from rfpipe.stages.offline import OfflineAcquisition

    sheet = read_sheet(folder)
    about = sheet.about
    config, results = run_paths(sheet)
    scene, name = about["scene"], about["method"]
    acquisition = OfflineAcquisition(load_config(config), scene, name, results / scene / name)
    if take_back:
        picture_files(pictures or folder / PICTURES)  # nothing else is left of them
        _take_back(acquisition, sheet)
        return
    checked = acquisition.read(sheet, pictures or folder / PICTURES, anyway=anyway)
    for note in checked.notes:
        typer.echo(f"{folder}: {note}", err=True)
    rig, is_new = checked.rig, not acquisition.files.exists(about["level"], "capture")
    try:
        level = acquisition.advance(rig)
    except CaptureError as error:
        if not is_new:
            raise
        acquisition.take_back(about["level"])
        raise CaptureError(f"{error}. None of these pictures is kept") from error
    before = "imported before and left as they are; others come after --take-back"
    typer.echo(
        f"{folder}: {counted(len(checked.files), 'bracket')} {'imported' if is_new else before}"
    )
    further = None if level is None else acquisition.write(rig, folder.parent, config, results)
    _tell(f"{scene} by {name}", further, results / scene / name, config)


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
                f"{later.folder / PICTURES}: holds pictures of patterns that may be others now; "
                "move them away",
                err=True,
            )
    typer.echo(f"{sheet.folder}: taken back. Import its pictures again when they are right")


def _tell(acquisition: str, sheet: Sheet | None, folder: Path, config: Path) -> None:
    """Say what is to be done next."""
    from rfpipe.storage.base import level_name

    if sheet is None:
        home, settings = str(folder.absolute().parents[2]), str(config.absolute())
        run = [sys.argv[0], "run", "--directory", home, "--configfile", settings]
        typer.echo(
            f"{acquisition}: nothing more is asked for; the transport is "
            f"{folder / 'transport.zarr'}. For the report: {shlex.join(run)}"
        )
        return
    about: dict[str, Any] = sheet.about
    times = ", ".join(f"{seconds:g}" for seconds in sheet.exposures_s)
    typer.echo(
        f"{acquisition}: {level_name(about['level'])} asks for "
        f"{counted(len(sheet.shown) - 3, 'pattern')} "
        f"and 3 markers. Show {sheet.folder}/*.png in their order, take of each the exposures "
        f"{times} s, put the pictures into {sheet.folder / 'pictures'}, then: "
        f"{shlex.join([sys.argv[0], 'import', str(sheet.folder)])}"
    )
