"""Publishing a run: all that goes into a crate, in the order in which it is read from afar."""

from __future__ import annotations

import json
import mimetypes
from collections.abc import Iterator, Set
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.errors import InputError
from rfpipe.pictures.images import write_image
from rfpipe.provenance import workflow_folder
from rfpipe.publishing.inputs import FOLDER as INPUTS
from rfpipe.publishing.inputs import inputs_of
from rfpipe.publishing.metadata import CRATE_FILE, Citation, crate, datacite
from rfpipe.publishing.run import (
    SETTINGS,
    Acquisition,
    Run,
    files_below,
    settings_file,
    settings_of,
)
from rfpipe.publishing.writing import Source, Writer, size_of, writing
from rfpipe.storage.files import REFERENCE_IMAGES, AcquisitionFolder
from rfpipe.store.places import CHECKSUMS
from rfpipe.transport.storage import STORE_NAME
from rfpipe.version import __version__

_WORKFLOW = "source/Snakefile"
_REPORT = "results/report/index.html"
_EXAMPLE, _PREVIEW = "read.py", "ro-crate-preview.html"
_FORMATS = {
    ".exr": "image/x-exr",
    ".md": "text/markdown",
    ".yaml": "application/yaml",
    ".zarr": "application/vnd+zarr",
}
# EXR files have the time of writing, which would change the bytes: that of the zip file's members.
_TIMELESS = {"DateTime": "1980:01:01 00:00:00"}


class Published(NamedTuple):
    """Files and bytes of a publication, and notes on what could not be taken along."""

    files: int
    nbytes: int
    notes: list[str]


def publish(
    run: Run,
    citation: Citation,
    output: Path,
    *,
    captured: bool = False,
    config: Path | None = None,
    overwrite: bool = False,
) -> Published:
    """Write a run's results as a crate, complete or not at all.

    Of equal results and citations the bytes are equal, too.

    Parameters
    ----------
    output : Path
        A zip file, where it ends so, or else a folder.
    captured : bool
        Publish the captured frames, too, and all that the stages made of them.
    config : Path, optional
        The run's settings, where it has no report to take them from.
    overwrite : bool
        Replace a publication that stands there.

    Raises
    ------
    InputError
        When something else stands there, or the settings aren't the run's.
    IntegrityError
        When a transport is damaged, or isn't the one that its manifest is about.
    StoreError
        When the disk is full or the folder isn't writable.
    """
    output = output.resolve() if output.is_symlink() else output.absolute()
    _check_output(run, output, overwrite)
    settings = settings_of(run, config)
    inputs = None if settings is None else inputs_of(run.folder, settings)
    for acquisition in run.acquisitions:
        acquisition.check()
    if inputs is not None:
        inputs.check_made(run.acquisitions)
    data = list(_data(run, captured=captured))
    if inputs is not None:
        data += [(SETTINGS, settings_file(inputs.settings)), *sorted(inputs.files.items())]
    with writing(output, sum(size_of(source) for _, source in data)) as writer:
        for name, source in data:
            writer.add(name, source)
        _add_metadata(writer, run, citation)
        sizes = [size for _, size in writer.written.values()]
    return Published(len(sizes), sum(sizes), inputs.notes if inputs else [])


def _check_output(run: Run, output: Path, overwrite: bool) -> None:
    """Never replace what wasn't published, nor anything unasked."""
    if output.resolve().is_relative_to(run.results.resolve()):
        raise InputError(
            f"{output}: lies among the results that are to be published; choose another"
        )
    if output.exists() and not overwrite:
        raise InputError(
            f"{output}: stands here already; give --overwrite to replace it, or another --output"
        )
    if output.is_dir() and any(output.iterdir()) and not (output / CHECKSUMS).is_file():
        raise InputError(
            f"{output}: is a folder that 'rfpipe publish' didn't make (it has no {CHECKSUMS}); "
            "give another --output"
        )


def _data(run: Run, *, captured: bool) -> Iterator[tuple[str, Source]]:
    """Yield name and source of all that isn't made for the publication."""
    for acquisition in run.acquisitions:
        yield from files_below(acquisition.folder / STORE_NAME, acquisition.store_name)
    for acquisition in run.acquisitions:
        yield f"{acquisition.name}/transport.json", acquisition.folder / "transport.json"
        yield from _floodlit(acquisition)
    yield from run.report_files()
    yield from run.captured() if captured else run.manifests()
    calibration = run.folder / "calibration"
    if (run.settings or {}).get("capture", {}).get("rig", "remote") == "remote":
        yield from files_below(calibration, "calibration")
    yield _WORKFLOW, workflow_folder() / "Snakefile"
    yield from files_below(workflow_folder() / "workflow", "source/workflow")


def _floodlit(acquisition: Acquisition) -> Iterator[tuple[str, bytes]]:
    """Yield name and content of an acquisition's picture under all light."""
    folder = AcquisitionFolder(acquisition.folder)
    if folder.store(0, REFERENCE_IMAGES).exists():
        floodlit = folder.read(0, "merge", REFERENCE_IMAGES)[0]["floodlit"]
        where = f"pictures/{acquisition.scene}/{acquisition.method}"
        for suffix in ("exr", "png"):
            yield f"{where}/floodlit.{suffix}", encoded(floodlit, suffix)


def encoded(image: NDArray[Any], suffix: str) -> bytes:
    """Return a picture, its views one above the other, as the bytes of a file: always the same."""
    picture = image.reshape(*RayDomain(image.shape[:-1]).picture_shape, image.shape[-1])
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"picture.{suffix}"
        write_image(path, picture, about=_TIMELESS)
        return path.read_bytes()


def _add_metadata(writer: Writer, run: Run, citation: Citation) -> None:
    """Write what is made for the publication: metadata, pages and, last, the manifest."""
    writer.add("datacite.json", _json(datacite(citation)))
    for name, page in _pages(run, citation, writer.written.keys()).items():
        writer.add(name, page)
    writer.add(CRATE_FILE, _json(_crate(writer, run, citation)))
    lines = [f"{digest}  {name}\n" for name, (digest, _) in sorted(writer.written.items())]
    writer.add(CHECKSUMS, "".join(lines).encode())


def _json(data: dict[str, Any]) -> bytes:
    return (json.dumps(data, indent=1, ensure_ascii=False) + "\n").encode()


def _pages(run: Run, citation: Citation, names: Set[str]) -> dict[str, bytes]:
    """Return what a reader sees first, by name: an example that runs, and pages about it."""
    from jinja2 import Environment, PackageLoader, select_autoescape

    templates = Environment(
        loader=PackageLoader("rfpipe.publishing", "."),
        autoescape=select_autoescape(["html.j2"]),
        keep_trailing_newline=True,
    )
    folders = {f"{folder}/" for name in names for folder in PurePosixPath(name).parents}
    values = {"run": run, "citation": citation, "version": __version__, "names": names | folders}
    pages = {}
    for name in (_EXAMPLE, "README.md", "CITATION.cff", _PREVIEW):
        pages[name] = templates.get_template(f"{name}.j2").render(values)
        values.setdefault("example", pages[name])
    return {name: page.encode() for name, page in pages.items()}


def _crate(writer: Writer, run: Run, citation: Citation) -> dict[str, Any]:
    """Describe all files but those of stores, which are described as wholes."""
    parts: dict[str, dict[str, str]] = {}
    for name, (digest, size) in writer.written.items():
        store, inside, _ = name.partition(".zarr/")
        whole = f"{store}.zarr/" if inside else name
        kind = mimetypes.guess_type(name)[0] or "text/plain"
        parts[whole] = {"name": whole, "encodingFormat": _FORMATS.get(Path(whole).suffix, kind)}
        if not inside:
            parts[whole] |= {"contentSize": str(size), "sha256": digest}
    del parts[_PREVIEW]
    stores = {f"{acquisition.store_name}/": acquisition.about for acquisition in run.acquisitions}
    for name, about in stores.items():
        parts[name]["description"] = about
    return crate(
        citation,
        parts,
        workflow=_WORKFLOW if _WORKFLOW in parts else None,
        settings=[name for name in parts if name == SETTINGS or name.startswith(f"{INPUTS}/")],
        outputs=[*stores, *(name for name in (_REPORT,) if name in parts)],
        times=run.times,
    )
