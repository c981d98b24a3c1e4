"""How machines read a publication: Croissant 1.0, the tables field by field."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from rfpipe.publish.citation import Citation, Creator

__all__ = ["croissant"]

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


def croissant(
    citation: Citation,
    digests: Mapping[str, str],
    formats: Mapping[str, str],
    tables: Mapping[str, bytes],
    stores: Mapping[str, str],
) -> dict[str, Any]:
    """Return a publication's Croissant metadata (JSON-LD).

    Parameters
    ----------
    citation : Citation
    digests : mapping of str to str
        SHA-256 of the files that it describes one by one, by name.
    formats : mapping of str to str
        Media types of these files, by name.
    tables : mapping of str to bytes
        Contents of the CSV files among them, by name.
    stores : mapping of str to str
        What each transport's folder is, by name.
    """
    distribution: list[dict[str, Any]] = [
        {
            "@type": "cr:FileObject",
            "@id": name,
            "name": name,
            "contentUrl": name,
            "encodingFormat": formats[name],
            "sha256": digest,
        }
        for name, digest in digests.items()
    ]
    distribution += [
        {
            "@type": "cr:FileSet",
            "@id": name,
            "name": name,
            "description": meaning,
            "encodingFormat": "application/vnd+zarr",
            "includes": f"{name}/**",
        }
        for name, meaning in stores.items()
    ]
    records = [_records(name, content) for name, content in tables.items()]
    return {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": f"{_CR}1.0",
        "name": citation.title,
        "description": citation.description,
        "license": citation.license_url,
        "url": f"https://doi.org/{citation.doi}" if citation.doi else "./",
        "version": citation.version,
        "datePublished": citation.published.isoformat(),
        "citeAs": citation.text,
        "creator": [_creator(creator) for creator in citation.creators],
        "keywords": list(citation.keywords),
        "distribution": distribution,
        "recordSet": [record for record in records if record["field"]],
    }


def _creator(creator: Creator) -> dict[str, str]:
    found = {"@type": "sc:Person" if "," in creator.name else "sc:Organization"}
    found["name"] = creator.name
    if creator.orcid:
        found["url"] = f"https://orcid.org/{creator.orcid}"
    return found


def _records(name: str, content: bytes) -> dict[str, Any]:
    """Describe a table: a record a row, a field a column."""
    header, *rows = csv.reader(io.StringIO(content.decode())) or [[]]
    label = name.rpartition("/")[2].removesuffix(".csv")
    return {
        "@type": "cr:RecordSet",
        "@id": label,
        "name": label,
        "field": [
            {
                "@type": "cr:Field",
                "@id": f"{label}/{column}",
                "name": column,
                "dataType": _type_of([row[index] for row in rows if index < len(row)]),
                "source": {"fileObject": {"@id": name}, "extract": {"column": column}},
            }
            for index, column in enumerate(header)
        ],
    }


def _type_of(values: list[str]) -> str:
    """Type of a column; a number where all that is there is one."""
    filled = [value for value in values if value]
    if not filled:
        return "sc:Text"
    with suppress(ValueError):
        for value in filled:
            int(value)
        if len(filled) == len(values):
            return "sc:Integer"
    with suppress(ValueError):
        for value in filled:
            float(value)
        return "sc:Float"
    return "sc:Text"
