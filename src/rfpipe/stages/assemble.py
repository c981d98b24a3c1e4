"""Stage: the transport, computed from what all levels added."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.provenance import fingerprint, versions
from rfpipe.references.reference_images import read_floodlit
from rfpipe.stages.context import Acquisition
from rfpipe.stages.normalize import masked_rays
from rfpipe.storage.base import REFERENCE_IMAGES, scheduled_levels
from rfpipe.storage.files import FolderStorage
from rfpipe.storage.picture_counts import pictures_of_levels
from rfpipe.storage.results import current_manifest
from rfpipe.store import write_manifest
from rfpipe.transport import Transport, save_transport
from rfpipe.transport.filling import fill_from_transpose
from rfpipe.units import RADIANCE_UNIT


def run(acquisition: Acquisition) -> None:
    """Write the transport, in a format of `rfpipe.transport.save_transport`, and its manifest."""
    plan, storage, settings = acquisition.plan, acquisition.storage, acquisition.settings
    assert isinstance(storage, FolderStorage)
    levels = list(scheduled_levels(storage))
    inputs = {
        "refine": [[level, storage.read_manifest(level, "refine")["digest"]] for level in levels],
        "references": storage.read_manifest(0, "merge")[REFERENCE_IMAGES]["digest"],
    }
    manifest = storage.path / "transport.json"
    inputs_fingerprint = fingerprint(
        {
            "plan": plan.describe(),
            **inputs,
            "number_format": settings.number_format,
            "code": settings.code,
        }
    )
    if current_manifest(manifest, inputs_fingerprint):
        return
    transport, masked = assembled(acquisition, len(levels))
    origin: dict[str, Any] = {
        "scene": settings.scene, "method": plan.name, "fingerprint": inputs_fingerprint,
    }  # fmt: skip
    store = manifest.with_suffix(".zarr")
    digest = save_transport(transport, store, settings.number_format, resumes=True, **origin)
    masked_count = int(np.count_nonzero(masked))
    facts = _facts(acquisition, transport, len(levels))
    facts |= {"inputs": inputs, "digest": digest, "masked": masked_count, "versions": versions()}
    write_manifest(manifest, {**origin, **facts})


def _facts(acquisition: Acquisition, transport: Transport, levels: int) -> dict[str, Any]:
    """Describe an acquisition and its transport for the manifest."""
    plan, settings = acquisition.plan, acquisition.settings
    return {
        "stage": "assemble",
        # the method that the settings' method chose, or itself
        "acquired_by": plan.method.name,
        "camera_shape": list(plan.camera.shape),
        "projector_shape": list(plan.projector.shape),
        "channels": plan.channels,
        "units": RADIANCE_UNIT,
        "levels": transport.level_rows,
        "patterns": sum(int(row["patterns"]) for row in transport.level_rows),
        # without verification, which follows the transport
        "pictures": pictures_of_levels(acquisition.storage, levels - 1).by_purpose(),
        "options": plan.options.options(),
        **({} if plan.prior is None else {"prior": plan.prior.describe()}),
        **({"sources": dict(settings.sources)} if settings.sources else {}),
    }


def assembled(acquisition: Acquisition, levels: int) -> tuple[Transport, NDArray[np.bool_]]:
    """Return the transport after a number of levels, and the masked camera rays."""
    masked = masked_rays(read_floodlit(acquisition.storage)[1])
    state = acquisition.state_before(levels)
    return fill_from_transpose(acquisition.plan.method.transport(state), masked), masked
