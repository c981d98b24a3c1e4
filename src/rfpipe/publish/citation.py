"""What a publication is cited by and licensed under, kept beside the run's results."""

from __future__ import annotations

import re
from collections.abc import Mapping
from datetime import date
from pathlib import Path
from typing import Annotated, Any, Self

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from rfpipe.errors import InputError
from rfpipe.store.files import storage_errors, write_atomically

__all__ = [
    "CITATION_FILE",
    "LICENSES",
    "UNPUBLISHED",
    "Citation",
    "Creator",
    "citation_values",
    "parse_citation",
    "write_citation",
]

CITATION_FILE = "publication.yaml"
"""Where a citation is kept, in the folder that holds a run's results."""

LICENSES = ("CC-BY-4.0", "CC0-1.0", "CC-BY-SA-4.0", "CC-BY-NC-4.0", "ODbL-1.0", "PDDL-1.0")
"""Names of licences for data, as in the SPDX list; others are taken as well."""

UNPUBLISHED = ":unav"
"""DataCite's word for what isn't known yet."""

_SPDX = r"[A-Za-z0-9][A-Za-z0-9.+-]*-[A-Za-z0-9.+-]*[0-9][A-Za-z0-9.+-]*"
_LICENSE = re.compile(rf"https?://\S+|{_SPDX}|MIT|ISC|Unlicense|WTFPL")
_ORCID = re.compile(r"(?:https://orcid\.org/)?(\d{4}-\d{4}-\d{4}-\d{3}[\dX])")
_DOI = re.compile(r"(?:https://doi\.org/|doi:)?(10\.\d{4,9}/\S+)")

_EXAMPLE = {
    "title": "-", "description": "-", "creators": [{"name": "-"}], "license": "CC0-1.0",
    "published": "2000-01-01",
}  # fmt: skip

Line = Annotated[str, Field(min_length=1, max_length=4000, pattern=r"\S")]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Creator(_Strict):
    """One who is to be cited."""

    name: Line
    orcid: str | None = None
    affiliation: Line | None = None

    @field_validator("orcid")
    @classmethod
    def _is_orcid(cls, orcid: str | None) -> str | None:
        if orcid is None:
            return None
        found = _ORCID.fullmatch(orcid)
        if found is None or _orcid_check(found[1]) != found[1][-1]:
            raise ValueError("should be an ORCID iD such as 0000-0002-1825-0097")
        return found[1]

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read ``Family, Given; ORCID; affiliation``, of which the name alone is needed.

        Raises
        ------
        InputError
            When it is anything else.
        """
        name, *more = [part.strip() for part in text.split(";")]
        orcid = next((part for part in more if _ORCID.fullmatch(part)), None)
        others = [part for part in more if part and part != orcid]
        if len(others) > 1:
            raise InputError(
                f"creator {text!r}: expected 'Family, Given; ORCID; affiliation'; repeat the "
                "option for each creator"
            )
        made: Self = _checked(
            cls, {"name": name, "orcid": orcid, "affiliation": "".join(others) or None}
        )
        return made


class Citation(_Strict):
    """What a publication is cited by.

    Attributes
    ----------
    title, description : str
    creators : tuple of Creator
        At least one.
    license : str
        Name in the SPDX list, such as CC-BY-4.0, or the address of its text.
    publisher : str
        Who keeps the publication: a repository; ``":unav"`` while that isn't known.
    published : date
    version : str
    keywords : tuple of str
    doi : str, optional
    """

    title: Line
    description: Line
    creators: tuple[Creator, ...] = Field(min_length=1)
    license: str
    publisher: Line = UNPUBLISHED
    published: date
    version: Annotated[str, Field(pattern=r"^\d+\.\d+\.\d+$")] = "1.0.0"
    keywords: tuple[Line, ...] = ("light transport", "reflectance field", "relighting")
    doi: str | None = None

    @field_validator("license")
    @classmethod
    def _is_license(cls, name: str) -> str:
        if not _LICENSE.fullmatch(name):
            raise ValueError(
                f"should be a licence's name in the SPDX list, such as {', '.join(LICENSES[:3])}, "
                "or the address of its text"
            )
        return name

    @field_validator("doi")
    @classmethod
    def _is_doi(cls, doi: str | None) -> str | None:
        if doi is None:
            return None
        found = _DOI.fullmatch(doi)
        if found is None:
            raise ValueError("should be a DOI such as 10.5281/zenodo.1234567")
        return found[1]

    @property
    def license_url(self) -> str:
        """Address of the licence's text."""
        if self.license.startswith("http"):
            return self.license
        return f"https://spdx.org/licenses/{self.license}"

    @property
    def text(self) -> str:
        """The citation on one line."""
        names = "; ".join(creator.name for creator in self.creators)
        kept = "" if self.publisher == UNPUBLISHED else f" {self.publisher}."
        doi = f" https://doi.org/{self.doi}" if self.doi else ""
        return (
            f"{names} ({self.published.year}): {self.title}. Version {self.version}.{kept} "
            f"Data set.{doi}"
        )


def citation_values(folder: Path, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a citation is made of: what is given, and for the rest what was kept.

    Parameters
    ----------
    folder : Path
        Holds the results and, once written, the citation.
    given : mapping
        Of `Citation`'s attributes; None says nothing.

    Raises
    ------
    InputError
        When what was kept is no citation.
    """
    path = folder / CITATION_FILE
    kept: Any = {}
    if path.exists():
        with storage_errors(path, "reading"):
            content = path.read_bytes()
        try:
            kept = yaml.safe_load(content)
        except (yaml.YAMLError, UnicodeDecodeError) as error:
            raise InputError(f"{path}: isn't YAML ({' '.join(str(error).split())})") from error
        if not isinstance(kept, dict):
            raise InputError(f"{path}: expected keys such as title, creators and license")
        parse_citation({**_EXAMPLE, **kept}, str(path))  # what is wrong in there is said of there
    return {**kept, **{name: value for name, value in given.items() if value is not None}}


def parse_citation(values: Mapping[str, Any], where: str = "") -> Citation:
    """Check the values of a citation.

    Raises
    ------
    InputError
        Names all that is wrong with them.
    """
    citation: Citation = _checked(Citation, dict(values), where)
    return citation


def write_citation(folder: Path, citation: Citation) -> None:
    """Keep a citation, so that nobody is asked again."""
    data = citation.model_dump(mode="json", exclude_none=True)
    text = yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=98)
    head = (
        "# What 'rfpipe publish' cites this run by; change it here, or by the command's options.\n"
    )
    content = (head + text).encode()
    path = folder / CITATION_FILE
    if not path.exists() or path.read_bytes() != content:
        write_atomically(path, content)


def _checked(model: Any, data: dict[str, Any], where: str = "") -> Any:
    try:
        return model.model_validate(data)
    except ValidationError as error:
        problems = "; ".join(map(_said, error.errors(include_url=False)))
        raise InputError(f"{where + ': ' if where else ''}{problems}") from error


def _said(problem: Any) -> str:
    place = ".".join(map(str, problem["loc"]))
    if problem["type"] == "extra_forbidden":
        return f"{place} is unknown; known are {', '.join(Citation.model_fields)}"
    return f"{place} {problem['input']!r}: {problem['msg'].removeprefix('Value error, ')}"


def _orcid_check(orcid: str) -> str:
    """Return the check digit of an ORCID iD (ISO 7064, 11-2)."""
    total = 0
    for digit in orcid.replace("-", "")[:15]:
        total = (total + int(digit)) * 2
    rest = (12 - total % 11) % 11
    return "X" if rest == 10 else str(rest)
