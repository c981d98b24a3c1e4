"""Where a report's numbers come from: versions, seeds, digests, settings, time and cost."""

from __future__ import annotations

from typing import Any

from rfpipe.provenance import fingerprint, versions
from rfpipe.report import tables
from rfpipe.report.drawn import plain_value
from rfpipe.report.entries import AcquisitionEntry, Provenance, VerificationEntry
from rfpipe.report.inputs import Inputs, Run
from rfpipe.report.placing import source_of

__all__ = ["provenance_of"]


def provenance_of(inputs: Inputs) -> Provenance:
    """Say what a report was made from."""
    shaping = inputs.config.shaping()
    verified = [run.verification_source for run in inputs.runs if run.verified]
    files = [*inputs.run_sources, *verified, *inputs.error_sources]
    return Provenance(
        versions=versions(),
        seed=inputs.config.seed,
        configuration=shaping,
        configuration_fingerprint=fingerprint(shaping),
        acquisitions=[
            _acquisition(run, cost, inputs.config.verification.fail_above)
            for run, cost in zip(inputs.runs, tables.costs(inputs), strict=True)
        ],
        sources=[source_of(file, inputs.results) for file in files],
    )


def _acquisition(run: Run, cost: dict[str, Any], accepted: float | None) -> AcquisitionEntry:
    return AcquisitionEntry(
        scene=run.scene,
        method=run.method,
        options=run.facts["options"],
        scene_settings=run.settings.model_dump(mode="json", exclude={"methods"}),
        transport_digest=run.acquired.get("digest"),
        relit_digest=run.images.digest,
        versions=run.facts.get("versions", {}),
        rays=run.rays,
        patterns=run.patterns,
        megabytes=cost["megabytes"],
        capture_s=cost["capture_s"],
        capture_jobs_s=plain_value(cost["capture_jobs_s"]),
        processing_s=plain_value(cost["processing_s"]),
        verification=_verification(run, accepted),
    )


def _verification(run: Run, accepted: float | None) -> VerificationEntry | None:
    if run.verified_images is None:
        return None
    fields = set(VerificationEntry.model_fields) - {"digest", "accepted"}
    return VerificationEntry(
        digest=run.verified_images.digest,
        accepted=accepted,
        **{name: run.verified[name] for name in fields},
    )
