"""How pictures become a transport: settings of merging, of what jobs may use, and of storing."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, field_validator

from rfpipe.config.addresses import THREADS, check_bucket, check_workers
from rfpipe.config.base import Settings

Normalization = Literal["none", "per_channel", "total_energy"]
NumberFormat = Literal["float32", "uint16", "uint8"]


class MergeConfig(Settings):
    """How a bracket becomes a radiance image."""

    mask_defects: bool = Field(
        True,
        description="Leave dead and hot pixels out, with an infinite variance: true or false. On a "
        "coaxial rig, what others see of them fills them in at the end.",
    )
    divide_out_drift: bool = Field(
        False,
        description="Divide images by the light's brightness at their time, where "
        "capture.drift_minutes had it measured: true or false.",
    )


class ResourcesConfig(Settings):
    """What a job may use; none of it changes a result."""

    memory_gib: float = Field(
        4.0,
        ge=0.5,
        le=1024,
        description="Memory that a job may take, in GiB, 0.5 to 1024. As many jobs as there are "
        "cores run side by side.",
    )
    workers: str = Field(
        THREADS,
        description="Where work is done: threads of the job, or the workers of a dask scheduler, "
        "by its address, such as tls://host:8786, which must see the results' folder under the "
        "same path. The environment variable RFPIPE_WORKERS goes before it. "
        "docs/parallel.md tells what pays. Over plain tcp:// whoever reaches the scheduler can "
        "run programs on all of these machines.",
    )

    jobs: Literal["stage", "acquisition"] | None = Field(
        None,
        description="What a job of the workflow is: stage, one stage of one level; or acquisition, "
        "a scene by a method from its first pattern to its transport, for collections and "
        "clusters. null: acquisition with a collection or with capture.placing, else stage. The "
        "same bytes either way, and one goes on with what the other left (docs/clusters.md).",
    )
    captures: Literal["here", "job"] = Field(
        "here",
        description="Where jobs that need a real rig run when others go to a cluster: here, beside "
        "Snakemake, which then is started on the rig's host; or job, as jobs of the cluster that "
        "the profile sends to the rig's host (docs/clusters.md).",
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
        "round a leaf's factors, by about 1e-5 and 3e-3 of their values. uint8 takes a quarter of "
        "float32's bytes; uint16 is for tolerances below 1e-4 without noise.",
    )
    keep_at: str | None = Field(
        None,
        description="Folder in a bucket of an object store, of this run alone, into which a run "
        "brings its transports, relit pictures and report at its end, such as s3://lab/desk; "
        "captures stay here. Credentials and endpoint come from the environment: docs/stores.md.",
    )

    @field_validator("keep_at")
    @classmethod
    def _is_in_a_bucket(cls, keep_at: str | None) -> str | None:
        if keep_at is not None:
            check_bucket(keep_at)
        return keep_at
