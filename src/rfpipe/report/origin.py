"""What a report was made from: versions, settings, digests, time and cost, as ``results.json``."""

from __future__ import annotations

import math
from typing import Any

from rfpipe.provenance import fingerprint, versions
from rfpipe.report import glance
from rfpipe.report.inputs import Inputs, Run

RESULTS_NAME = "results.json"


def provenance_of(inputs: Inputs) -> dict[str, Any]:
    """Return plain data that tells a report's origin."""
    shaping = inputs.config.shaping()
    costs = zip(inputs.runs, glance.results(inputs).to_dict("records"), strict=True)
    return {
        "versions": versions(),
        "seed": inputs.config.seed,
        "configuration": shaping,
        "configuration_fingerprint": fingerprint(shaping),
        "acquisitions": [_acquisition(*each) for each in costs],
    }


def _acquisition(run: Run, cost: dict[Any, Any]) -> dict[str, Any]:
    names = ("rays", "patterns", "megabytes", "capture_s", "capture_jobs_s", "processing_s")
    numbers = {name: float(cost[name]) for name in names}
    verified = {name: run.verified[name] for name in ("mean_error", "worst_error") if run.verified}
    return {
        "scene": run.scene,
        "method": run.method,
        "options": run.facts["options"],
        "versions": run.facts.get("versions", {}),
        "transport_digest": run.acquired.get("digest"),
        "relit_digest": run.images.digest,
        **{name: value if math.isfinite(value) else None for name, value in numbers.items()},
        "verification": verified or None,
    }
