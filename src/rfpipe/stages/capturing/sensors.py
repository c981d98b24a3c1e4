"""The sensor that took an acquisition's frames, as its capture left it on disk."""

from __future__ import annotations

from typing import Any

from rfpipe.photometry import Sensor, sensor_from_description
from rfpipe.stages.folder import AcquisitionFolder
from rfpipe.store import open_arrays, write_arrays

__all__ = ["SENSOR", "read_sensor", "write_sensor"]

SENSOR = "sensor"
"""A resampled sensor's arrays, beside the frames of level 0: their store and manifest's key."""


def write_sensor(folder: AcquisitionFolder, sensor: Sensor) -> dict[str, Any]:
    """Write what a description can't hold of a sensor; return its entry for the manifest."""
    arrays = getattr(sensor, "arrays", None)
    if arrays is None:
        return {}
    store = folder.store(0, SENSOR)
    write_arrays(store, arrays(), {"sensor": sensor.describe()})
    return {SENSOR: open_arrays(store).entry()}


def read_sensor(folder: AcquisitionFolder) -> Sensor:
    """Return the sensor that took the frames of an acquisition.

    Raises
    ------
    StoreError
        When level 0 isn't captured.
    IntegrityError
        When what it left is damaged.
    """
    captured = folder.read_manifest(0, "capture")
    arrays = folder.read(0, "capture", SENSOR)[0] if SENSOR in captured else None
    return sensor_from_description(captured["rig"]["sensor"], arrays)
