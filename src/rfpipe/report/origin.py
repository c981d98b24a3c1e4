"""Where a report's numbers come from: versions, seeds, digests, settings, time and cost."""

from __future__ import annotations

from typing import Any

from rfpipe.provenance import fingerprint, versions
from rfpipe.report import tables
from rfpipe.report.drawn import plain_value
from rfpipe.report.entries import AcquisitionEntry, Provenance
from rfpipe.report.inputs import Inputs, Run
from rfpipe.report.placing import source_of

__all__ = ["provenance_of"]


def provenance_of(inputs: Inputs) -> Provenance:
    """Say what a report was made from."""
    shaping = inputs.config.shaping()
    benches = [f"bench/{name}.csv" for name in inputs.benchmarks]
    studies = [study.source for study in inputs.studies.values()]
    files = [*inputs.run_sources, *studies, *inputs.error_sources, *benches]
    return Provenance(
        versions=versions(),
        seed=inputs.config.seed,
        configuration=shaping,
        configuration_fingerprint=fingerprint(shaping),
        acquisitions=[
            _acquisition(run, cost)
            for run, cost in zip(inputs.runs, tables.costs(inputs), strict=True)
        ],
        sources=[source_of(file, inputs.results) for file in files],
    )


def _acquisition(run: Run, cost: dict[str, Any]) -> AcquisitionEntry:
    return AcquisitionEntry(
        scene=run.scene,
        method=run.method,
        options=run.facts["options"],
        scene_settings=run.settings.model_dump(mode="json", exclude={"methods", "sweep"}),
        transport_digest=run.acquired.get("digest"),
        relit_digest=run.images.digest,
        versions=run.facts.get("versions", {}),
        rays=run.rays,
        patterns=run.patterns,
        megabytes=cost["megabytes"],
        capture_s=cost["capture_s"],
        capture_jobs_s=plain_value(cost["capture_jobs_s"]),
        processing_s=plain_value(cost["processing_s"]),
    )
