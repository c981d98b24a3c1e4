"""What a publication is cited by and licensed under, kept beside the run's results."""

from __future__ import annotations

import re
from collections.abc import Mapping
from datetime import date
from pathlib import Path
from typing import Annotated, Any, TypeVar

import yaml
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from rfpipe.errors import InputError
from rfpipe.store.files import storage_errors, write_atomically

CITATION_FILE = "publication.yaml"
"""Where a citation is kept, in the folder that holds a run's results."""

UNPUBLISHED = ":unav"
"""DataCite's word for what isn't known yet."""

_SPDX = r"[A-Za-z0-9][A-Za-z0-9.+-]*-[A-Za-z0-9.+-]*[0-9][A-Za-z0-9.+-]*"
_LICENSE = re.compile(rf"https?://\S+|{_SPDX}|MIT|ISC|Unlicense|WTFPL")
_ORCID = re.compile(r"(?:https://orcid\.org/)?(\d{4}-\d{4}-\d{4}-\d{3}[\dX])")
_DOI = re.compile(r"(?:https://doi\.org/|doi:)?(10\.\d{4,9}/\S+)")

M = TypeVar("M", bound=BaseModel)


def _license(name: str) -> str:
    if not _LICENSE.fullmatch(name):
        raise ValueError(
            "should be a licence's name in the SPDX list, such as CC-BY-4.0, CC0-1.0, "
            "CC-BY-SA-4.0, or the address of its text"
        )
    return name


def _orcid(text: str) -> str:
    found = _ORCID.fullmatch(text)
    if found is None or _check_digit(found[1]) != found[1][-1]:
        raise ValueError("should be an ORCID iD such as 0000-0002-1825-0097")
    return found[1]


def _check_digit(orcid: str) -> str:
    """Return the check digit of an ORCID iD (ISO 7064, 11-2)."""
    total = 0
    for digit in orcid.replace("-", "")[:15]:
        total = (total + int(digit)) * 2
    return "0123456789X"[(12 - total % 11) % 11]


def _doi(text: str) -> str:
    found = _DOI.fullmatch(text)
    if found is None:
        raise ValueError("should be a DOI such as 10.5281/zenodo.1234567")
    return found[1]


Line = Annotated[str, Field(min_length=1, max_length=4000, pattern=r"\S")]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Creator(_Strict):
    """One who is to be cited."""

    name: Line
    orcid: Annotated[str, AfterValidator(_orcid)] | None = None
    affiliation: Line | None = None

    @classmethod
    def parse(cls, text: str) -> Creator:
        """Read ``Family, Given; ORCID; affiliation``, of which the name alone is needed."""
        name, *more = [part.strip() for part in text.split(";")]
        orcid = next((part for part in more if _ORCID.fullmatch(part)), None)
        others = [part for part in more if part and part != orcid]
        if len(others) > 1:
            raise InputError(
                f"creator {text!r}: expected 'Family, Given; ORCID; affiliation'; repeat the "
                "option for each creator"
            )
        return checked(cls, {"name": name, "orcid": orcid, "affiliation": next(iter(others), None)})

    @property
    def is_person(self) -> bool:
        """Whether it is a person, by the comma of the name or the ORCID iD."""
        return "," in self.name or self.orcid is not None

    @property
    def orcid_url(self) -> str | None:
        """The address of the ORCID iD."""
        return f"https://orcid.org/{self.orcid}" if self.orcid else None


class Citation(_Strict):
    """What a publication is cited by.

    Attributes
    ----------
    license : str
        Name in the SPDX list, such as CC-BY-4.0, or the address of its text.
    publisher : str
        Who keeps the publication: a repository; ``":unav"`` while that isn't known.
    """

    title: Line
    description: Line
    creators: tuple[Creator, ...] = Field(min_length=1)
    license: Annotated[str, AfterValidator(_license)]
    publisher: Line = UNPUBLISHED
    published: date
    version: Annotated[str, Field(pattern=r"^\d+\.\d+\.\d+$")] = "1.0.0"
    keywords: tuple[Line, ...] = ("light transport", "reflectance field", "relighting")
    doi: Annotated[str, AfterValidator(_doi)] | None = None

    @property
    def license_url(self) -> str:
        """Address of the licence's text."""
        if self.license.startswith("http"):
            return self.license
        return f"https://spdx.org/licenses/{self.license}"

    @property
    def doi_url(self) -> str | None:
        """The DOI as an address."""
        return f"https://doi.org/{self.doi}" if self.doi else None

    @property
    def text(self) -> str:
        """The citation on one line."""
        names = "; ".join(creator.name for creator in self.creators)
        publisher = "" if self.publisher == UNPUBLISHED else f" {self.publisher}."
        return (
            f"{names} ({self.published.year}): {self.title}. Version {self.version}.{publisher} "
            f"Data set. {self.doi_url or ''}"
        ).rstrip()


def kept_values(folder: Path) -> dict[str, Any]:
    """Return what is kept of a citation in a run's folder; InputError when it is no citation."""
    path = folder / CITATION_FILE
    if not path.exists():
        return {}
    with storage_errors(path, "reading"):
        content = path.read_bytes()
    try:
        kept = yaml.safe_load(content)
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: isn't YAML ({' '.join(str(error).split())})") from error
    unknown = set(kept) - set(Citation.model_fields) if isinstance(kept, dict) else {"a text"}
    if unknown:
        raise InputError(
            f"{path}: {', '.join(sorted(unknown))} is unknown; known are "
            f"{', '.join(Citation.model_fields)}"
        )
    return dict(kept)


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


def checked(model: type[M], values: Mapping[str, Any]) -> M:
    """Return a model of some values, or raise InputError that names all that is wrong."""
    try:
        return model.model_validate(dict(values))
    except ValidationError as error:
        problems = "; ".join(
            f"{'.'.join(map(str, problem['loc']))} {problem['input']!r}: "
            f"{problem['msg'].removeprefix('Value error, ')}"
            for problem in error.errors(include_url=False)
        )
        raise InputError(problems) from error
