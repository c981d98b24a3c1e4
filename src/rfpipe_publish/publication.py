"""Publishing a run: all that goes into a crate, in the order in which it is read from afar."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.errors import InputError, StoreError, installing
from rfpipe.pictures.images import write_image
from rfpipe.stages.folder import AcquisitionFolder
from rfpipe.stages.merger import REFERENCES
from rfpipe.transport.storage import MANIFEST
from rfpipe_publish.citation import Citation
from rfpipe_publish.crate import METADATA_FILE, crate_metadata
from rfpipe_publish.metadata import croissant, datacite
from rfpipe_publish.pages import CITATION, EXAMPLE, PREVIEW, pages
from rfpipe_publish.run import SETTINGS, Acquisition, Run, Source, files_of_store, settings_of
from rfpipe_publish.writing import Writer, writing

_WORKFLOW = "source/Snakefile"
_REPORT = "results/report/index.html"
_FORMATS = {
    ".cff": "application/yaml",
    ".css": "text/css",
    ".csv": "text/csv",
    ".exr": "image/x-exr",
    ".html": "text/html",
    ".js": "text/javascript",
    ".json": "application/json",
    ".jsonl": "application/jsonl",
    ".md": "text/markdown",
    ".png": "image/png",
    ".py": "text/x-python",
    ".wasm": "application/wasm",
    ".yaml": "application/yaml",
}
_MEANINGS = {
    "results/catalogue/index.html": "the catalogue: each acquisition with a small picture, its "
    "figures and what the table says of it",
    EXAMPLE: "opens a transport and relights it: ten lines of Python",
    "results/report/": "the report: index.html, its tables, figures and numbers",
    "results/report/view/": "pages to paint with light in, in any browser",
    "pictures/": "of each acquisition the floodlit picture (radiance) and the black level (counts)",
    SETTINGS: "all settings that shaped the results, to run them again",
    "calibration/": "the rig's calibration",
    "provenance/": "the manifests of all stages: what was shown and captured, and its digests",
    "source/": "the workflow that was run",
    METADATA_FILE: "what each file is and how it came about (Workflow Run RO-Crate)",
    "datacite.json": "metadata to register a DOI with (DataCite 4.5)",
    "croissant.json": "the tables field by field, for machines (Croissant 1.0)",
    CITATION: "how to cite it",
    MANIFEST: "SHA-256 of every file",
}
# EXR files have the time of writing, which would change the bytes: that of the zip file's members.
_TIMELESS = {"DateTime": "1980:01:01 00:00:00"}


def publish(
    run: Run,
    citation: Citation,
    output: Path,
    *,
    captured: bool = False,
    config: Path | None = None,
    calibration: Path | None = None,
    overwrite: bool = False,
) -> tuple[int, int]:
    """Write a run's results as a crate, complete or not at all; return its files and bytes.

    Of equal results and citations the bytes are equal, too.

    Parameters
    ----------
    run : Run
    citation : Citation
    output : Path
        A zip file, where it ends so, or else a folder.
    captured : bool
        Whether to publish the captured frames, too, and all that the stages made of them.
    config : Path, optional
        The run's settings, where it has no report to take them from.
    calibration : Path, optional
        Folder of the rig's calibration; by default ``calibration`` beside the results of a run
        with a rig of devices.
    overwrite : bool
        Whether to replace a publication that stands there.

    Raises
    ------
    InputError
        When something else stands there, or the settings aren't the run's.
    IntegrityError
        When a transport is damaged, or isn't the one that its manifest is about.
    StoreError
        When a package is missing, the disk is full or the folder isn't writable.
    """
    try:
        import rocrate.rocrate  # noqa: F401
    except ImportError as error:
        raise StoreError(f"to publish, {installing('publish')}") from error
    output = output.absolute()
    _check_output(run, output, overwrite)
    settings = settings_of(run, config)
    calibrated = _calibration_of(run, calibration)
    for acquisition in run.acquisitions:
        acquisition.check()
    data = list(_data(run, calibrated, captured=captured))
    if settings is not None:
        data.append((SETTINGS, settings))
    needed = sum(len(s) if isinstance(s, bytes) else s.stat().st_size for _, s in data)
    with writing(output, needed) as writer:
        for name, source in data:
            writer.add(name, source)
        _add_metadata(writer, run, citation)
        return len(writer.sizes), sum(writer.sizes.values())


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
    if output.is_dir() and any(output.iterdir()) and not (output / MANIFEST).is_file():
        raise InputError(
            f"{output}: is a folder that 'rfpipe publish' didn't make (it has no {MANIFEST}); give "
            "another --output"
        )


def _data(run: Run, calibration: Path | None, *, captured: bool) -> Iterator[tuple[str, Source]]:
    """Yield name and source of all that isn't made for the publication."""
    for acquisition in run.acquisitions:
        yield from files_of_store(acquisition.store, acquisition.store_name)
    for acquisition in run.acquisitions:
        yield f"{acquisition.name}/transport.json", acquisition.folder / "transport.json"
        yield from _reference_pictures(acquisition)
    yield from run.report_files()
    yield from run.captured() if captured else run.manifests()
    if calibration is not None:
        yield from _tree("calibration", calibration, calibration.rglob("*"))
    source = Path(__file__).parents[2]  # where rfpipe runs from its sources
    if (source / "Snakefile").is_file() and (source / "workflow").is_dir():
        files = [source / "Snakefile", *(source / "workflow").rglob("*")]
        yield from _tree("source", source, files)


def _calibration_of(run: Run, given: Path | None) -> Path | None:
    """Return the folder of the calibration that belongs to a run, if any does."""
    if given is not None:
        if not (given / "calibration.json").is_file():
            raise InputError(f"{given}: is no calibration; expected a folder of 'rfpipe calibrate'")
        return given
    folder = run.folder / "calibration"
    rig = (run.settings or {}).get("capture", {}).get("rig", "remote")
    return folder if rig == "remote" and (folder / "calibration.json").is_file() else None


def _tree(top: str, folder: Path, files: Any) -> Iterator[tuple[str, Path]]:
    for file in sorted(files):
        inside = file.relative_to(folder)
        kept = not any(part.startswith((".", "__pycache__")) for part in inside.parts)
        if kept and file.is_file() and file.suffix != ".log":
            yield f"{top}/{inside.as_posix()}", file


def _reference_pictures(acquisition: Acquisition) -> Iterator[tuple[str, bytes]]:
    """Yield name and content of an acquisition's reference pictures."""
    folder = AcquisitionFolder(acquisition.folder)
    if not folder.store(0, REFERENCES).exists():
        return
    arrays, _ = folder.read(0, "merge", REFERENCES)
    where = f"pictures/{acquisition.scene}/{acquisition.method}"
    floodlit = arrays["floodlit"].reshape(*acquisition.facts["camera_shape"], -1)
    for suffix in ("exr", "png"):
        yield f"{where}/floodlit.{suffix}", encoded(floodlit, suffix)
    for exposure, counts in enumerate(arrays["black"]):
        # a mosaic's has no channels
        has_channels = counts.ndim > 2 and counts.shape[-1] in (1, 3)
        yield (
            f"{where}/black_{exposure}.exr",
            encoded(counts if has_channels else counts[..., None], "exr"),
        )


def encoded(image: NDArray[Any], suffix: str) -> bytes:
    """Return a picture, its views one above the other, as the bytes of a file: always the same."""
    picture = image.reshape(*RayDomain(image.shape[:-1]).picture_shape, image.shape[-1])
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"picture.{suffix}"
        write_image(path, picture, about=_TIMELESS)
        return path.read_bytes()


def _add_metadata(writer: Writer, run: Run, citation: Citation) -> None:
    """Write what is made for the publication: pages, metadata and, last, the manifest."""
    stores = {f"{found.store_name}/": found.about for found in run.acquisitions}
    described = {
        name: (_format(name), digest)
        for name, digest in writer.digests.items()
        if name.endswith((".csv", ".exr")) and ".zarr/" not in name
    }
    tables = {
        name: run.folder / name for name in described if name.startswith("results/report/tables/")
    }
    for name, data in {
        "datacite.json": datacite(citation, sum(writer.sizes.values())),
        "croissant.json": croissant(citation, described, tables, stores),
    }.items():
        text = json.dumps(data, indent=2, ensure_ascii=False) + "\n"
        writer.add(name, text.encode())
    made = (EXAMPLE, CITATION, METADATA_FILE, MANIFEST)
    present = [*writer.digests, *made]
    has_report = _REPORT in writer.digests
    meanings = stores | {
        name: meaning
        for name, meaning in _MEANINGS.items()
        if any(each == name or (name[-1] == "/" and each.startswith(name)) for each in present)
        and (has_report or name != "results/report/")
    }
    about = pages(run, citation, meanings, writer.digests)
    preview = about.pop(PREVIEW)
    for name, content in about.items():
        writer.add(name, content)
    parts = {
        name: {
            "name": name,
            "encodingFormat": _format(name),
            "contentSize": str(writer.sizes[name]),
            "sha256": digest,
            **({"description": _MEANINGS[name]} if name in _MEANINGS else {}),
        }
        for name, digest in writer.digests.items()
        if ".zarr/" not in name
    }
    for name in writer.digests:
        store, found, _ = name.partition(".zarr/")
        if found:
            name_of = f"{store}.zarr/"
            about_it = {"description": stores[name_of]} if name_of in stores else {}
            parts[name_of] = {
                "name": name_of,
                "encodingFormat": "application/vnd+zarr",
                **about_it,
            }
    metadata = crate_metadata(
        citation,
        parts,
        workflow=_WORKFLOW if _WORKFLOW in writer.digests else None,
        settings=[name for name in (SETTINGS,) if name in writer.digests],
        outputs=[*stores, *([_REPORT] if has_report else [])],
        times=run.times,
    )
    writer.add(PREVIEW, preview)
    writer.add(METADATA_FILE, metadata.encode())
    lines = [f"{digest}  {name}\n" for name, digest in sorted(writer.digests.items())]
    writer.add(MANIFEST, "".join(lines).encode())


def _format(name: str) -> str:
    return _FORMATS.get(Path(name).suffix, "text/plain")
