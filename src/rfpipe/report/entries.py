"""What ``results.json`` holds: every number of a report's page, and where it comes from."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Field

from rfpipe.errors import StoreError
from rfpipe.store.files import canonical_json, write_atomically

__all__ = [
    "FORMAT",
    "RESULTS_NAME",
    "SCHEMA_NAME",
    "AcquisitionEntry",
    "Bars",
    "Curve",
    "Exposure",
    "FigureEntry",
    "Panel",
    "Provenance",
    "Results",
    "SectionEntry",
    "Source",
    "TableEntry",
    "Value",
    "VerificationEntry",
    "VerifiedPicture",
    "read_results",
    "results_schema",
    "write_results",
]

FORMAT: Final = "rfpipe results 1"
"""Version of the file's format; another one where a field changes its meaning or is taken out."""

RESULTS_NAME = "results.json"
SCHEMA_NAME = "results.schema.json"

Value = bool | int | float | str | None
"""A number or text; null where there is none (NaN), "inf" where it is infinite."""


class _Entry(BaseModel):
    """Base of all entries: unknown keys are errors, numbers are finite."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Source(_Entry):
    """A file that something was made from."""

    file: str = Field(description="Its path from the results folder.")
    digest: str = Field(description="SHA-256 of its bytes, the first 128 bits in hexadecimal.")


class Exposure(_Entry):
    """How a picture of light is shown."""

    picture: str = Field(description="Its name, which its part of the EXR file has, too.")
    quantity: str = Field(description="What its numbers are: radiance, or albedo.")
    white: float = Field(gt=0, description="The number shown as white.")
    brightened: float = Field(description="The largest factor on its pixels, for the screen only.")


class Curve(_Entry):
    """A line, or the outline of a band; one number where it crosses the panel at that place."""

    label: str
    x: list[Value]
    y: list[Value]


class Bars(_Entry):
    """Bars of one name: their lower left corners and sizes."""

    label: str
    x: list[Value]
    y: list[Value]
    width: list[Value]
    height: list[Value]


class Panel(_Entry):
    """What a panel of a figure shows."""

    title: str
    x_label: str
    y_label: str
    x_scale: str
    y_scale: str
    texts: list[str] = Field(description="Texts within the panel.")
    curves: list[Curve]
    bars: list[Bars]
    areas: list[Curve] = Field(description="Outlines of bands, and bars of error.")
    image: list[Value] = Field(description="Numbers at both ends of a map's colours, or nothing.")


class FigureEntry(_Entry):
    """A figure or picture."""

    kind: Literal["figure"] = "figure"
    name: str
    caption: str
    alt: str = Field(description="What it says, for those who can't see it.")
    png: str = Field(description="The file for screens, from the page's folder.")
    png_digest: str
    width: int = Field(gt=0, description="Pixels.")
    height: int = Field(gt=0, description="Pixels.")
    exr: str | None = Field(description="Linear light of its pictures, a part each; null: none.")
    exr_digest: str | None
    exposures: list[Exposure]
    panels: list[Panel]
    sources: list[Source]


class TableEntry(_Entry):
    """A table."""

    kind: Literal["table"] = "table"
    name: str
    caption: str
    groups: list[tuple[str, int]] = Field(description="Headings over so many columns each.")
    columns: list[str]
    rows: list[list[str]] = Field(description="Cells as the page shows them.")
    records: list[dict[str, Value]] = Field(description="The numbers behind, in full.")
    csv: str | None = Field(description="The file with these, from the page's folder.")
    sources: list[Source]


class SectionEntry(_Entry):
    """A section of the page."""

    anchor: str
    title: str
    text: list[str]
    content: list[Annotated[FigureEntry | TableEntry, Field(discriminator="kind")]]


class VerifiedPicture(_Entry):
    """A picture that no method saw, captured and relit; all relative to its norm."""

    name: str
    difference: Value = Field(description="Between both pictures, with noise.")
    noise: Value = Field(description="Noise floor: what of it the captured picture's noise makes.")
    error: Value = Field(description="The difference without the noise's share.")
    standard_error: Value


class VerificationEntry(_Entry):
    """What a transport is wrong by, and what else tells of the rig during the capture."""

    digest: str = Field(description="Digest of the pictures.")
    pictures: list[VerifiedPicture]
    mean_error: Value
    worst_error: Value
    worst_picture: str
    noise: Value = Field(description="Mean noise floor.")
    accepted: float | None = Field(description="Mean error above which the run fails.")
    gain: list[float] = Field(
        description="The lamp's light at the verification, relative to the acquisition's "
        "beginning, by channel: divided out of the captured pictures."
    )
    drift: float | None = Field(description="Largest change of the lamp's light; null: no look.")
    moved: float | None = Field(
        description="Largest change of the repeated pattern, relative; null: no look."
    )
    reciprocity: float | None = Field(
        description="Error that asymmetry makes in a picture, at least; null: not watched."
    )
    reciprocity_deviations: float | None = Field(
        description="Largest residual of reciprocity, in standard deviations; about 1 is right."
    )
    alarms: list[str] = Field(description="Where the rig moved, or wasn't aligned.")
    saturated: int = Field(description="Samples saturated at every exposure.")
    samples: int
    devices: dict[str, int] = Field(description="What the devices counted, by device and what.")


class AcquisitionEntry(_Entry):
    """A scene acquired with a method: what it was made from, and what it cost."""

    scene: str
    method: str
    options: dict[str, Any] = Field(description="The method's options.")
    scene_settings: dict[str, Any] = Field(description="What light is modelled, among others.")
    transport_digest: str | None = Field(description="Digest of the stored light transport.")
    relit_digest: str = Field(description="Digest of the pictures relit from it.")
    versions: dict[str, str] = Field(description="Of what computed it.")
    rays: int = Field(description="Projector rays, and so the patterns of brute force.")
    patterns: int
    megabytes: float = Field(description="10⁶ bytes on disk, compressed.")
    capture_s: float = Field(description="Capture at the stated seconds a pattern.")
    capture_jobs_s: Value = Field(description="Wall seconds of the capture as it ran here.")
    processing_s: Value = Field(description="Wall seconds of all other stages.")
    verification: VerificationEntry | None = Field(
        description="What its transport is wrong by on pictures that no method saw; null: none "
        "were taken."
    )


class Provenance(_Entry):
    """What the report was made from."""

    versions: dict[str, str] = Field(description="Of what made the report.")
    seed: int = Field(description="Seed of the captures' noise; scenes have their own.")
    configuration: dict[str, Any] = Field(description="All settings that shape results.")
    configuration_fingerprint: str
    acquisitions: list[AcquisitionEntry]
    sources: list[Source] = Field(description="All manifests and tables that were read.")


class Results(_Entry):
    """Every number that a report's page shows, machine-readable."""

    format: Literal["rfpipe results 1"] = FORMAT
    title: str
    lead: str
    provenance: Provenance
    sections: list[SectionEntry]

    @property
    def figures(self) -> list[FigureEntry]:
        """The figures of all sections."""
        return [
            entry
            for section in self.sections
            for entry in section.content
            if isinstance(entry, FigureEntry)
        ]


def results_schema() -> dict[str, Any]:
    """Return the JSON schema of ``results.json``."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **Results.model_json_schema(mode="serialization"),
    }


def write_results(path: Path, results: Results) -> None:
    """Write a report's numbers; the same numbers give the same bytes."""
    plain = results.model_dump(mode="json")
    write_atomically(path, canonical_json(plain, str(path), indent=1) + b"\n")


def read_results(path: Path) -> Results:
    """Read a report's numbers.

    Raises
    ------
    StoreError
        When the file is missing, or isn't one of this format.
    """
    try:
        return Results.model_validate(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError) as error:
        raise StoreError(
            f"{path}: can't be read as a report's numbers ({error}); run the report stage again"
        ) from error
