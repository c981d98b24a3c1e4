"""Publication of a run as a crate, with files in the order in which they are read remotely."""

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
from rfpipe.installation import workflow_folder
from rfpipe.pictures.images import write_image
from rfpipe.publishing.inputs import INPUTS_FOLDER, inputs_of
from rfpipe.publishing.metadata import CRATE_FILE, Citation, crate, datacite
from rfpipe.publishing.run import (
    SETTINGS,
    FinishedAcquisition,
    RunFolder,
    files_below,
    settings_file,
    settings_of,
)
from rfpipe.publishing.writing import Source, Writer, size_of, writing
from rfpipe.storage.base import REFERENCE_IMAGES
from rfpipe.storage.files import FolderStorage
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
# Time in EXR files, for reproducible bytes: that of the zip file's members.
_TIMELESS = {"DateTime": "1980:01:01 00:00:00"}


class Published(NamedTuple):
    """Numbers of files and bytes of a publication, and notes on missing user files."""

    files: int
    nbytes: int
    notes: list[str]


def publish(
    run: RunFolder,
    citation: Citation,
    output: Path,
    *,
    captured: bool = False,
    config: Path | None = None,
    overwrite: bool = False,
) -> Published:
    """Write a run's results as a crate, atomically and reproducibly.

    Equal results and citations give equal bytes.

    Parameters
    ----------
    output : Path
        A zip file, if it ends in ``.zip``, else a folder.
    captured : bool
        Include the captured frames and the results of all stages.
    config : Path, optional
        The run's settings, for a run without a report.
    overwrite : bool
        Replace an existing publication.

    Raises
    ------
    InputError
        When the output exists, or user files have changed since the run.
    IntegrityError
        When a transport is damaged, or its digest isn't that of its manifest.
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
        inputs.check_sources(run.acquisitions)
    data = list(_data(run, captured=captured))
    if inputs is not None:
        data += [(SETTINGS, settings_file(inputs.settings)), *sorted(inputs.files.items())]
    with writing(output, sum(size_of(source) for _, source in data)) as writer:
        for name, source in data:
            writer.add(name, source)
        _add_metadata(writer, run, citation)
        sizes = [size for _, size in writer.written.values()]
    return Published(len(sizes), sum(sizes), inputs.notes if inputs else [])


def _check_output(run: RunFolder, output: Path, overwrite: bool) -> None:
    """Raise InputError if writing the output would replace other files."""
    if output.resolve().is_relative_to(run.results.resolve()):
        raise InputError(f"{output}: is within the results to be published; give another --output")
    if output.exists() and not overwrite:
        raise InputError(
            f"{output}: exists already; give --overwrite to replace it, or another --output"
        )
    if output.is_dir() and any(output.iterdir()) and not (output / CHECKSUMS).is_file():
        raise InputError(
            f"{output}: is not a publication, since it has no {CHECKSUMS}; give another --output"
        )


def _data(run: RunFolder, *, captured: bool) -> Iterator[tuple[str, Source]]:
    """Yield name and source of all files of the run and its workflow."""
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


def _floodlit(acquisition: FinishedAcquisition) -> Iterator[tuple[str, bytes]]:
    """Yield name and content of an acquisition's floodlit image, as EXR and PNG."""
    folder = FolderStorage(acquisition.folder)
    if folder.store(0, REFERENCE_IMAGES).exists():
        floodlit = folder.read(0, "merge", REFERENCE_IMAGES)[0]["floodlit"]
        place = f"pictures/{acquisition.scene}/{acquisition.method}"
        for suffix in ("exr", "png"):
            yield f"{place}/floodlit.{suffix}", encoded(floodlit, suffix)


def encoded(image: NDArray[Any], suffix: str) -> bytes:
    """Encode an image as reproducible bytes of a file, with its views in one picture."""
    picture = image.reshape(*RayDomain(image.shape[:-1]).picture_shape, image.shape[-1])
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"picture.{suffix}"
        write_image(path, picture, attributes=_TIMELESS)
        return path.read_bytes()


def _add_metadata(writer: Writer, run: RunFolder, citation: Citation) -> None:
    """Write metadata, pages and, last, the list of checksums."""
    writer.add("datacite.json", _json(datacite(citation)))
    for name, page in _pages(run, citation, writer.written.keys()).items():
        writer.add(name, page)
    writer.add(CRATE_FILE, _json(_crate(writer, run, citation)))
    lines = [f"{digest}  {name}\n" for name, (digest, _) in sorted(writer.written.items())]
    writer.add(CHECKSUMS, "".join(lines).encode())


def _json(data: dict[str, Any]) -> bytes:
    return (json.dumps(data, indent=1, ensure_ascii=False) + "\n").encode()


def _pages(run: RunFolder, citation: Citation, names: Set[str]) -> dict[str, bytes]:
    """Render the example program and the pages about the publication, by file name."""
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


def _crate(writer: Writer, run: RunFolder, citation: Citation) -> dict[str, Any]:
    """Build the crate's metadata; each store is described as one folder."""
    parts: dict[str, dict[str, str]] = {}
    for name, (digest, size) in writer.written.items():
        store, inside, _ = name.partition(".zarr/")
        part = f"{store}.zarr/" if inside else name
        kind = mimetypes.guess_type(name)[0] or "text/plain"
        parts[part] = {"name": part, "encodingFormat": _FORMATS.get(Path(part).suffix, kind)}
        if not inside:
            parts[part] |= {"contentSize": str(size), "sha256": digest}
    del parts[_PREVIEW]
    stores = {
        f"{acquisition.store_name}/": acquisition.description for acquisition in run.acquisitions
    }
    for name, description in stores.items():
        parts[name]["description"] = description
    return crate(
        citation,
        parts,
        workflow=_WORKFLOW if _WORKFLOW in parts else None,
        settings=[
            name for name in parts if name == SETTINGS or name.startswith(f"{INPUTS_FOLDER}/")
        ],
        outputs=[*stores, *(name for name in (_REPORT,) if name in parts)],
        times=run.times,
    )
