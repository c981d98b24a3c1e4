"""Citation of a publication, and its metadata in the formats of DataCite and RO-Crate."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from datetime import date
from pathlib import Path
from typing import Annotated, Any

import yaml
from pydantic import AfterValidator, BeforeValidator, Field, ValidationError, model_validator

from rfpipe.config.base import Settings
from rfpipe.config.mistakes import mistake_lines
from rfpipe.config.reading import read_yaml
from rfpipe.errors import InputError, UnsuitableValueError
from rfpipe.store.files import write_atomically
from rfpipe.text import similar_names
from rfpipe.version import __version__

CITATION_FILE = "publication.yaml"
"""File of the citation in a run's folder."""

CRATE_FILE = "ro-crate-metadata.json"

_UNPUBLISHED = ":unav"  # DataCite's value for unknown entries
_LICENCES = (
    *("CC0-1.0", "CC-BY-4.0", "CC-BY-SA-4.0", "CC-BY-NC-4.0", "CC-BY-NC-SA-4.0", "CC-BY-ND-4.0"),
    *("CC-BY-NC-ND-4.0", "ODbL-1.0", "ODC-By-1.0", "PDDL-1.0", "CDLA-Permissive-2.0", "MIT"),
    *("Apache-2.0", "BSD-2-Clause", "BSD-3-Clause", "GPL-3.0-only", "GPL-3.0-or-later"),
    *("LGPL-3.0-or-later", "AGPL-3.0-or-later", "MPL-2.0", "EUPL-1.2", "ISC", "Unlicense"),
)
"""Suggestions for misspelt licences; every licence of the SPDX list is accepted."""

_ORCID = re.compile(r"\d{4}-\d{4}-\d{4}-\d{3}[\dX]")
_DOI = re.compile(r"10\.\d{4,9}/\S+")
_VERSION = re.compile(r"\d+\.\d+\.\d+")
_PROFILES = {
    "https://w3id.org/ro/wfrun/process/0.5": "Process Run Crate",
    "https://w3id.org/ro/wfrun/workflow/0.5": "Workflow Run Crate",
    "https://w3id.org/workflowhub/workflow-ro-crate/1.0": "Workflow RO-Crate",
}
_SNAKEMAKE = "https://w3id.org/workflowhub/workflow-ro-crate#snakemake"
# terms that the context of RO-Crate 1.1 lacks
_TERMS = {
    "creditText": "http://schema.org/creditText",
    "sha256": "https://w3id.org/ro/terms/workflow-run#sha256",
}

Graph = dict[str, dict[str, Any]]


def _bare(text: object) -> str:
    """Remove the resolver's address from a DOI or an ORCID iD."""
    return re.sub(r"^(https://(doi|orcid)\.org/|doi:)", "", str(text))


def check_digit(digits: str) -> str:
    """Compute the check digit of an ORCID iD's first 15 digits (ISO 7064 MOD 11-2)."""
    total = 0
    for digit in digits:
        total = 2 * (total + int(digit))
    value = (12 - total % 11) % 11
    return "X" if value == 10 else str(value)


def _orcid(text: str) -> str:
    """Validate an ORCID iD and its check digit; UnsuitableValueError if it is wrong."""
    if _ORCID.fullmatch(text) is None:
        raise UnsuitableValueError("be four groups of four digits, of which the last may be X")
    expected = check_digit(text[:-1].replace("-", ""))
    if text[-1] != expected:
        raise UnsuitableValueError(
            f"end in the check digit {expected}: a digit is wrong, or two are exchanged"
        )
    return text


def _licence(text: str) -> str:
    """Normalize a licence: an address, or a name of the SPDX list; else UnsuitableValueError."""
    from packaging.licenses import InvalidLicenseExpression, canonicalize_license_expression

    if re.fullmatch(r"https?://\S+", text):
        return text
    try:
        name = str(canonicalize_license_expression(text))
    except InvalidLicenseExpression:
        name = ""
    if name and " " not in name and not name.startswith("LicenseRef-"):
        return name
    names = {licence.lower(): licence for licence in _LICENCES}
    key = re.sub(r"[^a-z0-9.]+", "-", text.lower())
    suggestions = [names[name] for name in similar_names(key, names, cutoff=0.5)]
    suggestion = f" (did you mean {suggestions[0]}?)" if suggestions else ""
    raise UnsuitableValueError(f"be the name of one licence of the SPDX list{suggestion}")


def _matching(pattern: re.Pattern[str], expected: str) -> AfterValidator:
    """Build a validator of a pattern; `expected` describes it in the message."""

    def check(text: str) -> str:
        if pattern.fullmatch(text) is None:
            raise UnsuitableValueError(f"be {expected}")
        return text

    return AfterValidator(check)


Line = Annotated[str, Field(min_length=1, max_length=4000, pattern=r"\S")]
Bare = Annotated[str, BeforeValidator(_bare)]


class Creator(Settings):
    """A creator to be cited; also parsed from ``Family, Given; ORCID; affiliation``."""

    name: Line
    orcid: Annotated[Bare, AfterValidator(_orcid)] | None = Field(
        None, description="ORCID iD such as 0000-0002-1825-0097"
    )
    affiliation: Line | None = None

    @model_validator(mode="before")
    @classmethod
    def _from_text(cls, value: object) -> object:
        if not isinstance(value, str):
            return value
        parts = (part.strip() for part in value.split(";", 2))
        return {name: part for name, part in zip(cls.model_fields, parts, strict=False) if part}

    @property
    def url(self) -> str | None:
        """Address of the ORCID iD."""
        return f"https://orcid.org/{self.orcid}" if self.orcid else None

    @property
    def kind(self) -> str:
        """Type in schema.org: a name with a comma or an ORCID iD is that of a person."""
        return "Person" if "," in self.name or self.orcid else "Organization"


class Citation(Settings):
    """The citation of a publication; `publisher` is the repository that hosts it."""

    title: Line
    description: Line = (
        "Light transport between a projector and a camera, acquired with rfpipe, for relighting "
        "with any pattern."
    )
    creators: tuple[Creator, ...] = Field(
        min_length=1, description="each as 'Family, Given; ORCID; affiliation'; or give --creator"
    )
    license: Annotated[str, AfterValidator(_licence)] = Field(
        description="its name in the SPDX list, such as CC-BY-4.0, or an address; or --license",
    )
    publisher: Line = _UNPUBLISHED
    published: date
    version: Annotated[str, _matching(_VERSION, "three numbers such as 1.0.0")] = "1.0.0"
    keywords: tuple[Line, ...] = ("light transport", "reflectance field", "relighting")
    doi: Annotated[Bare, _matching(_DOI, "10., a number, a slash and a name")] | None = Field(
        None, description="such as 10.5281/zenodo.1234567"
    )

    @property
    def license_url(self) -> str:
        """Address of the licence's text."""
        is_address = self.license.startswith("http")
        return self.license if is_address else f"https://spdx.org/licenses/{self.license}"

    @property
    def doi_url(self) -> str | None:
        """The DOI as an address."""
        return f"https://doi.org/{self.doi}" if self.doi else None

    @property
    def text(self) -> str:
        """The citation in one line."""
        names = "; ".join(creator.name for creator in self.creators)
        publisher = "" if self.publisher == _UNPUBLISHED else f" {self.publisher}."
        return (
            f"{names} ({self.published.year}): {self.title}. Version {self.version}.{publisher} "
            f"Data set. {self.doi_url or ''}"
        ).rstrip()


def stored_values(folder: Path) -> dict[str, Any]:
    """Read the citation in a run's folder, without validation."""
    path = folder / CITATION_FILE
    values = read_yaml(path) if path.exists() else {}
    return values if isinstance(values, dict) else {str(values): ""}


def write_citation(folder: Path, values: Mapping[str, Any]) -> Citation:
    """Validate a citation and write it to a run's folder.

    Raises
    ------
    InputError
        With a line for each missing or invalid entry.
    """
    path = folder / CITATION_FILE
    entries = {name: value for name, value in values.items() if value is not None}
    try:
        citation = Citation.model_validate(entries)
    except ValidationError as error:
        lines = [f"{path}: {line}" for line in mistake_lines(error)]
        raise InputError("\n".join(lines)) from None
    data = citation.model_dump(mode="json", exclude_none=True)
    text = yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=98)
    write_atomically(
        path,
        f"# Citation of this run for 'rfpipe publish'; may be edited.\n{text}".encode(),
        resumes=False,
    )
    return citation


def datacite(citation: Citation) -> dict[str, Any]:
    """Build the DataCite metadata of a publication (schema 4.5)."""
    creators = []
    for creator in citation.creators:
        names: dict[str, Any] = {"name": creator.name}
        if creator.orcid:
            scheme = {"nameIdentifierScheme": "ORCID", "schemeUri": "https://orcid.org"}
            names["nameIdentifiers"] = [{"nameIdentifier": creator.url, **scheme}]
        if creator.affiliation:
            names["affiliation"] = [{"name": creator.affiliation}]
        kind = {"Person": "Personal", "Organization": "Organizational"}[creator.kind]
        creators.append({**names, "nameType": kind})
    return {
        **({"doi": citation.doi} if citation.doi else {}),
        "creators": creators,
        "titles": [{"title": citation.title}],
        "publisher": {"name": citation.publisher},
        "publicationYear": str(citation.published.year),
        "types": {"resourceType": "Light transport", "resourceTypeGeneral": "Dataset"},
        "subjects": [{"subject": word} for word in citation.keywords],
        "dates": [{"date": citation.published.isoformat(), "dateType": "Issued"}],
        "version": citation.version,
        "rightsList": [{"rights": citation.license, "rightsUri": citation.license_url}],
        "descriptions": [{"description": citation.description, "descriptionType": "Abstract"}],
        "schemaVersion": "http://datacite.org/schema/kernel-4",
    }


def crate(
    citation: Citation,
    parts: Mapping[str, Mapping[str, Any]],
    *,
    workflow: str | None,
    settings: Sequence[str],
    outputs: Sequence[str],
    times: tuple[str, str],
) -> dict[str, Any]:
    """Build the RO-Crate 1.1 metadata (JSON-LD): a description of each file and of the run.

    Parameters
    ----------
    parts : mapping of str to mapping
        Properties of every file and folder, by name; the names of folders end in a slash.
    workflow : str, optional
        Name of the workflow's main file. Without it, the crate is a Process Run Crate of rfpipe.
    settings, outputs : sequence of str
        Names of the run's inputs and outputs, among the parts.
    times : tuple of str
        Begin and end of the run, ISO 8601.
    """
    graph: Graph = {}
    files = [
        _add(graph, name, "Dataset" if name.endswith("/") else "File", **properties)
        for name, properties in parts.items()
    ]
    creators = _add_creators(graph, citation)
    rfpipe = _add(
        graph, "#rfpipe", "SoftwareApplication", name="rfpipe", softwareVersion=__version__
    )
    root = _root_of(citation, creators)
    instrument = rfpipe
    if workflow:
        instrument = _add_workflow(graph, workflow, parts[workflow], rfpipe)
        root["mainEntity"] = instrument
    if citation.publisher != _UNPUBLISHED:
        root["publisher"] = _add(graph, "#publisher", "Organization", name=citation.publisher)
    profiles = _add_profiles(graph, len(_PROFILES) if workflow else 1)
    description = f"The licence {citation.license}."
    root["license"] = _add(
        graph, citation.license_url, "CreativeWork", name=citation.license, description=description
    )
    root["mentions"] = _add(
        graph,
        "#run",
        "CreateAction",
        name="Acquisition of these results",
        startTime=times[0],
        endTime=times[1],
        instrument=instrument,
        agent=creators,
        object=[{"@id": name} for name in settings],
        result=[{"@id": name} for name in outputs],
    )
    root |= {"creditText": citation.text, "conformsTo": profiles, "hasPart": files}
    dataset = _add(graph, "./", "Dataset", **root)
    conforms = [{"@id": "https://w3id.org/ro/crate/1.1"}, *profiles[2:]]
    _add(graph, CRATE_FILE, "CreativeWork", conformsTo=conforms, about=dataset)
    context = ["https://w3id.org/ro/crate/1.1/context", _TERMS]
    return {"@context": context, "@graph": [*graph.values()]}


def _root_of(citation: Citation, creators: list[dict[str, str]]) -> dict[str, Any]:
    """Build the properties of the root dataset that come from the citation."""
    root: dict[str, Any] = {
        "name": citation.title,
        "description": citation.description,
        "datePublished": citation.published.isoformat(),
        "version": citation.version,
        "keywords": ", ".join(citation.keywords),
        "creator": creators,
        "author": creators,
    }
    return root | ({"identifier": citation.doi_url} if citation.doi else {})


def _add_creators(graph: Graph, citation: Citation) -> list[dict[str, str]]:
    creators = []
    for number, creator in enumerate(citation.creators, 1):
        properties: dict[str, Any] = {"name": creator.name}
        if creator.affiliation:
            properties["affiliation"] = _add(
                graph, f"#affiliation-{number}", "Organization", name=creator.affiliation
            )
        key = creator.url or f"#creator-{number}"
        creators.append(_add(graph, key, creator.kind, **properties))
    return creators


def _add_workflow(
    graph: Graph, name: str, properties: Mapping[str, Any], software: dict[str, str]
) -> dict[str, str]:
    language = _add(graph, _SNAKEMAKE, "ComputerLanguage", name="Snakemake")
    kinds = ("File", "SoftwareSourceCode", "ComputationalWorkflow")
    return _add(graph, name, kinds, **properties, programmingLanguage=language, hasPart=software)


def _add_profiles(graph: Graph, count: int) -> list[dict[str, str]]:
    return [
        _add(graph, key, "CreativeWork", name=name, version=key.rpartition("/")[2])
        for key, name in [*_PROFILES.items()][:count]
    ]


def _add(graph: Graph, key: str, kind: str | Sequence[str], **properties: Any) -> dict[str, str]:
    """Add an entity to the graph, and return a reference to it."""
    graph[key] = {"@id": key, "@type": kind, **properties}
    return {"@id": key}
