"""Stage: the transport, from what all levels added."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.provenance import fingerprint, versions
from rfpipe.references.reference_images import read_floodlit
from rfpipe.stages.normalize import masked_rays
from rfpipe.stages.plan import Plan
from rfpipe.storage.files import REFERENCE_IMAGES, AcquisitionFolder, standing
from rfpipe.store import write_manifest
from rfpipe.transport import Transport, save_transport
from rfpipe.transport.filling import fill_from_transpose
from rfpipe.units import RADIANCE_UNIT, NumberFormat


def run(
    plan: Plan,
    folder: AcquisitionFolder,
    *,
    scene: str,
    number_format: NumberFormat,
    code: str,
    sources: Mapping[str, str] | None = None,
) -> None:
    """Write the transport, in a format of `rfpipe.transport.save_transport`, and its manifest.

    The manifest has the digests `sources` of a user's files, see `rfpipe.stages.plan`.
    """
    plan.settle(folder)
    levels = folder.levels_above(None)
    made_of = {
        "refine": [[level, folder.read_manifest(level, "refine")["digest"]] for level in levels],
        "references": folder.read_manifest(0, "merge")[REFERENCE_IMAGES]["digest"],
    }
    manifest = folder.path / "transport.json"
    made_from = fingerprint(
        {
            "plan": plan.describe(),
            **made_of,
            "number_format": number_format,
            "code": code,
        }
    )
    if standing(manifest, made_from):
        return
    transport, masked = assembled(plan, folder)
    about: dict[str, Any] = {"scene": scene, "method": plan.name, "fingerprint": made_from}
    store = manifest.with_suffix(".zarr")
    digest = save_transport(transport, store, number_format, resumes=True, **about)
    write_manifest(
        manifest,
        {
            **about,
            "stage": "assemble",
            "made_of": made_of,
            # what a choice came to
            "acquired_by": plan.method.name,
            "digest": digest,
            "camera_shape": list(plan.camera.shape),
            "projector_shape": list(plan.projector.shape),
            "channels": plan.channels,
            "units": RADIANCE_UNIT,
            "levels": transport.level_rows,
            "patterns": sum(int(row["patterns"]) for row in transport.level_rows),
            "options": plan.options.options(),
            "masked": int(np.count_nonzero(masked)),
            **({"sources": dict(sources)} if sources else {}),
            "versions": versions(),
        },
    )


def assembled(plan: Plan, folder: AcquisitionFolder) -> tuple[Transport, NDArray[np.bool_]]:
    """Return the transport of a refined acquisition, and its masked camera rays."""
    masked = masked_rays(read_floodlit(folder)[1])
    state = plan.state_before(folder, None)
    return fill_from_transpose(plan.method.transport(state), masked), masked
