"""What a repository needs to register a DOI: DataCite's metadata, version 4."""

from __future__ import annotations

from typing import Any

from rfpipe.publish.citation import Citation, Creator

__all__ = ["datacite"]


def datacite(citation: Citation, nbytes: int) -> dict[str, Any]:
    """Return DataCite's metadata (schema 4.5) of a publication.

    Parameters
    ----------
    citation : Citation
    nbytes : int
        Bytes of all of its files.
    """
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
    family, comma, given = creator.name.partition(",")
    names: dict[str, Any] = {"name": creator.name}
    if comma:
        names |= {
            "nameType": "Personal",
            "familyName": family.strip(),
            "givenName": given.strip(),
        }
    if creator.orcid:
        names["nameIdentifiers"] = [
            {
                "nameIdentifier": f"https://orcid.org/{creator.orcid}",
                "nameIdentifierScheme": "ORCID",
                "schemeUri": "https://orcid.org",
            }
        ]
    if creator.affiliation:
        names["affiliation"] = [{"name": creator.affiliation}]
    return names
