"""How machines read a publication: DataCite 4.5 for a DOI, Croissant 1.0 for the tables."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rfpipe_publish.citation import Citation, Creator

_CR = "http://mlcommons.org/croissant/"
_TERMS = (
    "citeAs", "column", "containedIn", "equivalentProperty", "extract", "field", "fileObject",
    "fileProperty", "fileSet", "format", "includes", "isLiveDataset", "jsonPath", "key", "md5",
    "parentField", "path", "recordSet", "references", "regex", "repeated", "replace",
    "samplingRate", "separator", "source", "subField", "transform",
)  # fmt: skip
_CONTEXT: dict[str, Any] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "sc": "https://schema.org/",
    "cr": _CR,
    "rai": f"{_CR}RAI/",
    "dct": "http://purl.org/dc/terms/",
    "conformsTo": "dct:conformsTo",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "examples": {"@id": "cr:examples", "@type": "@json"},
    **{term: f"cr:{term}" for term in _TERMS},
}
_TYPES = {"i": "sc:Integer", "f": "sc:Float"}


def croissant(
    citation: Citation,
    files: Mapping[str, tuple[str, str]],
    tables: Mapping[str, Path],
    stores: Mapping[str, str],
) -> dict[str, Any]:
    """Return a publication's Croissant metadata (JSON-LD).

    Parameters
    ----------
    citation : Citation
    files : mapping of str to (str, str)
        Media type and SHA-256 of the files that it describes one by one, by name.
    tables : mapping of str to Path
        The CSV files among them.
    stores : mapping of str to str
        What each transport's folder is, by name.
    """
    distribution: list[dict[str, Any]] = [
        {
            "@type": "cr:FileObject",
            "@id": name,
            "name": name,
            "contentUrl": name,
            "encodingFormat": kind,
            "sha256": digest,
        }
        for name, (kind, digest) in files.items()
    ]
    distribution += [
        {
            "@type": "cr:FileSet",
            "@id": name.rstrip("/"),
            "name": name.rstrip("/"),
            "description": meaning,
            "encodingFormat": "application/vnd+zarr",
            "includes": f"{name}**",
        }
        for name, meaning in stores.items()
    ]
    creators = [
        {
            "@type": "sc:Person" if creator.is_person else "sc:Organization",
            "name": creator.name,
            **({"url": creator.orcid_url} if creator.orcid else {}),
        }
        for creator in citation.creators
    ]
    return {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": f"{_CR}1.0",
        "name": citation.title,
        "description": citation.description,
        "license": citation.license_url,
        "url": citation.doi_url or "./",
        "version": citation.version,
        "datePublished": citation.published.isoformat(),
        "citeAs": citation.text,
        "creator": creators,
        "keywords": list(citation.keywords),
        "distribution": distribution,
        "recordSet": [_records(name, file) for name, file in tables.items()],
    }


def _records(name: str, file: Path) -> dict[str, Any]:
    """Describe a table: a record a row, a field a column."""
    import pandas as pd

    label = file.stem
    return {
        "@type": "cr:RecordSet",
        "@id": label,
        "name": label,
        "field": [
            {
                "@type": "cr:Field",
                "@id": f"{label}/{column}",
                "name": column,
                "dataType": "sc:Text"
                if values.isna().all()
                else _TYPES.get(values.dtype.kind, "sc:Text"),
                "source": {"fileObject": {"@id": name}, "extract": {"column": column}},
            }
            for column, values in pd.read_csv(file).items()
        ],
    }


def datacite(citation: Citation, nbytes: int) -> dict[str, Any]:
    """Return DataCite's metadata (schema 4.5) of a publication of so many bytes."""
    rights: dict[str, str] = {"rights": citation.license, "rightsUri": citation.license_url}
    if not citation.license.startswith("http"):
        rights |= {
            "rightsIdentifier": citation.license,
            "rightsIdentifierScheme": "SPDX",
            "schemeUri": "https://spdx.org/licenses/",
        }
    return {
        **({"doi": citation.doi} if citation.doi else {}),
        "creators": [_creator(creator) for creator in citation.creators],
        "titles": [{"title": citation.title, "lang": "en"}],
        "publisher": {"name": citation.publisher},
        "publicationYear": str(citation.published.year),
        "types": {"resourceType": "Light transport", "resourceTypeGeneral": "Dataset"},
        "subjects": [{"subject": word} for word in citation.keywords],
        "dates": [{"date": citation.published.isoformat(), "dateType": "Issued"}],
        "language": "en",
        "sizes": [f"{nbytes} bytes"],
        "formats": ["application/vnd+zarr", "image/x-exr", "text/csv", "text/html"],
        "version": citation.version,
        "rightsList": [rights],
        "descriptions": [
            {"description": citation.description, "descriptionType": "Abstract", "lang": "en"}
        ],
        "schemaVersion": "http://datacite.org/schema/kernel-4",
    }


def _creator(creator: Creator) -> dict[str, Any]:
    names: dict[str, Any] = {"name": creator.name}
    family, comma, given = creator.name.partition(",")
    if comma:
        people = {"familyName": family.strip(), "givenName": given.strip()}
        names |= {"nameType": "Personal", **people}
    if creator.orcid:
        scheme = {"nameIdentifierScheme": "ORCID", "schemeUri": "https://orcid.org"}
        names["nameIdentifiers"] = [{"nameIdentifier": creator.orcid_url, **scheme}]
    if creator.affiliation:
        names["affiliation"] = [{"name": creator.affiliation}]
    return names
