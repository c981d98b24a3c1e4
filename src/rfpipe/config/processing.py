"""How pictures become a transport and a report: merging, storing, resources, report."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, field_validator

from rfpipe.config.addresses import THREADS, check_bucket, check_workers
from rfpipe.config.base import Settings, Text
from rfpipe.units import NumberFormat

Normalization = Literal["none", "per_channel", "total_energy"]


class MergeConfig(Settings):
    """How a bracket becomes a radiance image."""

    mask_defects: bool = Field(
        True, description="Whether dead and hot pixels are left out, with an infinite variance."
    )
    divide_out_drift: bool = Field(
        False,
        description="Whether images are divided by the light's brightness at their time, which "
        "capture.drift_minutes has measured.",
    )


class ResourcesConfig(Settings):
    """What a job may use; none of it changes a result."""

    memory_gib: float = Field(
        4.0, ge=0.5, le=1024, description="Memory that a job may take, in GiB, 0.5 to 1024."
    )
    workers: str = Field(
        THREADS,
        description="Where work is done: threads, or the workers of a dask scheduler by its "
        "address, such as tls://host:8786 (docs/parallel.md).",
    )
    jobs: Literal["stage", "acquisition"] | None = Field(
        None,
        description="A job of the workflow: a stage of a level, or a whole acquisition; null: "
        "acquisition with a collection or capture.placing, else stage.",
    )
    captures: Literal["here", "job"] = Field(
        "here",
        description="Where jobs of a real rig run: here, beside Snakemake, or as jobs of the "
        "cluster (docs/clusters.md).",
    )

    @field_validator("workers")
    @classmethod
    def _workers_are_somewhere(cls, where: str) -> str:
        check_workers(where)
        return where


class StorageConfig(Settings):
    """How the transport is stored."""

    number_format: NumberFormat = Field(
        "uint8",
        description="Numbers of a stored transport: float32 keeps every bit; uint16 and uint8 "
        "round by about 1e-5 and 3e-3.",
    )
    keep_at: str | None = Field(
        None,
        description="Folder in a bucket, of this run alone, into which its results go at its end, "
        "such as s3://lab/desk (docs/stores.md).",
    )

    @field_validator("keep_at")
    @classmethod
    def _is_in_a_bucket(cls, keep_at: str | None) -> str | None:
        if keep_at is not None:
            check_bucket(keep_at)
        return keep_at


class ReportConfig(Settings):
    """What the report shows."""

    page: bool | None = Field(
        None,
        description="Whether a run ends with the report on each scene; null: unless it has a "
        "collection, which has a catalogue.",
    )
    title: Text | None = Field(
        None, description="The report's title; null: Light transport, of as many scenes as it has."
    )
