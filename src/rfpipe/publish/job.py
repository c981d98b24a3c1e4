"""Publishing: all that goes into a crate, in the order in which it is read from afar."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rfpipe.errors import InputError
from rfpipe.publish.citation import Citation
from rfpipe.publish.contents import SETTINGS, Acquisition, Run, files_of_store, settings_of
from rfpipe.publish.crate import METADATA_FILE, PREVIEW_FILE, crate_metadata, need_rocrate
from rfpipe.publish.croissant import croissant
from rfpipe.publish.datacite import datacite
from rfpipe.publish.pages import EXAMPLE, citation_cff, example, page, readme
from rfpipe.publish.pictures import reference_pictures
from rfpipe.publish.writing import Writer, writing
from rfpipe.transport.places import MANIFEST

__all__ = ["Published", "publish"]

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
    "CITATION.cff": "how to cite it",
    MANIFEST: "SHA-256 of every file",
}


@dataclass(frozen=True)
class Published:
    """What was published.

    Attributes
    ----------
    path : Path
        The zip file or folder.
    files : int
    nbytes : int
        Of all files.
    """

    path: Path
    files: int
    nbytes: int


def publish(
    run: Run,
    citation: Citation,
    output: Path,
    *,
    captured: bool = False,
    config: Path | None = None,
    calibration: Path | None = None,
    overwrite: bool = False,
) -> Published:
    """Write a run's results as a crate, complete or not at all.

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

    Returns
    -------
    Published

    Raises
    ------
    InputError
        When something else stands there, or the settings aren't the run's.
    IntegrityError
        When a transport is damaged, or isn't the one that its manifest is about.
    StoreError
        When a package is missing, the disk is full or the folder isn't writable.
    """
    need_rocrate()
    output = output.absolute()
    if output.resolve().is_relative_to(run.results.resolve()):
        raise InputError(
            f"{output}: lies among the results that are to be published; choose another"
        )
    settings = settings_of(run, config)
    calibrated = _calibration_of(run, calibration)
    for acquisition in run.acquisitions:
        acquisition.check()
    data = list(_data(run, calibrated, captured=captured))
    needed = sum(len(s) if isinstance(s, bytes) else s.stat().st_size for _, s in data)
    with writing(output, overwrite=overwrite, needed_bytes=needed) as writer:
        for name, source in data:
            writer.add(name, source)
        if settings is not None:
            writer.add(SETTINGS, settings)
        _add_pages(writer, run, citation)
        files, nbytes = len(writer.sizes), sum(writer.sizes.values())
    return Published(output, files, nbytes)


def _data(
    run: Run, calibration: Path | None, *, captured: bool
) -> Iterator[tuple[str, Path | bytes]]:
    """Yield name and place, or content, of all that isn't made for the publication."""
    for acquisition in run.acquisitions:
        yield from files_of_store(acquisition.store, f"{acquisition.name}/{acquisition.store.name}")
    for acquisition in run.acquisitions:
        yield f"{acquisition.name}/transport.json", acquisition.folder / "transport.json"
        yield from reference_pictures(acquisition)
    yield from run.report_files()
    yield from run.captured() if captured else run.manifests()
    for top, place in (("calibration", calibration), ("source", _workflow_source())):
        if place is not None:
            yield from _tree(place, top)


def _calibration_of(run: Run, given: Path | None) -> Path | None:
    """Return the folder of the calibration that belongs to a run, if any does."""
    if given is not None:
        if not (given / "calibration.json").is_file():
            raise InputError(f"{given}: is no calibration; expected a folder of 'rfpipe calibrate'")
        return given
    folder = run.folder / "calibration"
    rig = (run.settings or {}).get("capture", {}).get("rig", "remote")
    return folder if rig == "remote" and (folder / "calibration.json").is_file() else None


def _workflow_source() -> Path | None:
    """Return the folder of the workflow, where rfpipe runs from its sources."""
    folder = Path(__file__).parents[3]
    return folder if (folder / "Snakefile").is_file() and (folder / "workflow").is_dir() else None


def _tree(folder: Path, top: str) -> Iterator[tuple[str, Path]]:
    """Yield name and place of the files of a calibration, or of the workflow."""
    if top == "source":
        files = [folder / "Snakefile", *(folder / "workflow").rglob("*")]
    else:
        files = [*folder.rglob("*")]
    for file in sorted(files):
        inside = file.relative_to(folder)
        kept = not any(part.startswith((".", "__pycache__")) for part in inside.parts)
        if kept and file.is_file() and file.suffix != ".log":
            yield f"{top}/{inside.as_posix()}", file


def _add_pages(writer: Writer, run: Run, citation: Citation) -> None:
    """Write what is made for the publication: pages, metadata and, last, the manifest."""
    first = run.acquisitions[0]
    writer.add(EXAMPLE, example(first).encode())
    writer.add("CITATION.cff", citation_cff(citation).encode())
    nbytes = sum(writer.sizes.values())
    writer.add("datacite.json", _json(datacite(citation, nbytes)))
    stores = {f"{found.name}/{found.store.name}": _about(found) for found in run.acquisitions}
    named = {
        name: digest
        for name, digest in writer.digests.items()
        if name.endswith((".csv", ".exr")) and ".zarr/" not in name
    }
    tables = {
        name: (run.folder / name).read_bytes()
        for name in named
        if name.startswith("results/report/tables/")
    }
    formats = {name: _format(name) for name in named}
    writer.add("croissant.json", _json(croissant(citation, named, formats, tables, stores)))
    present = {**dict.fromkeys(writer.digests), METADATA_FILE: None, MANIFEST: None}
    without = () if run.report else ("results/report/",)
    meanings = {
        **{f"{name}/": meaning for name, meaning in stores.items()},
        **{
            name: meaning
            for name, meaning in _MEANINGS.items()
            if name not in without
            and any(each == name or each.startswith(name) * (name[-1] == "/") for each in present)
        },
    }
    writer.add("README.md", readme(run, citation, meanings, MANIFEST, first).encode())
    metadata = crate_metadata(
        citation,
        _parts(writer, stores),
        workflow=_WORKFLOW if _WORKFLOW in writer.digests else None,
        settings=[name for name in (SETTINGS,) if name in writer.digests],
        outputs=[*(f"{name}/" for name in stores), *([_REPORT] if run.report else [])],
        times=run.times,
    )
    writer.add(PREVIEW_FILE, page(run, citation, meanings, writer.digests).encode())
    writer.add(METADATA_FILE, metadata.encode())
    lines = [f"{digest}  {name}\n" for name, digest in sorted(writer.digests.items())]
    writer.add(MANIFEST, "".join(lines).encode())


def _parts(writer: Writer, stores: dict[str, str]) -> dict[str, dict[str, Any]]:
    """Return the properties of every file, and of every store as a whole."""
    parts: dict[str, dict[str, Any]] = {
        f"{name}/": {
            "name": name,
            "description": about,
            "encodingFormat": "application/vnd+zarr",
        }
        for name, about in stores.items()
    }
    for name, digest in writer.digests.items():
        store, found, _ = name.partition(".zarr/")
        if found:
            parts.setdefault(
                f"{store}.zarr/", {"name": store, "encodingFormat": "application/vnd+zarr"}
            )
            continue
        parts[name] = {
            "name": name,
            "encodingFormat": _format(name),
            "contentSize": str(writer.sizes[name]),
            "sha256": digest,
        }
        if name in _MEANINGS:
            parts[name]["description"] = _MEANINGS[name]
    return parts


def _about(found: Acquisition) -> str:
    return (
        f"light transport of {found.scene} by {found.method}, {found.facts['patterns']:,} "
        "patterns (zarr 3)"
    )


def _format(name: str) -> str:
    return _FORMATS.get(Path(name).suffix, "text/plain")


def _json(data: dict[str, Any]) -> bytes:
    return (json.dumps(data, indent=2, ensure_ascii=False) + "\n").encode()
