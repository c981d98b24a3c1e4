"""Camera model and its inverse: noise, HDR merge, mosaic, defects, normalization."""

from rfpipe.photometry.camera import CameraModel, sensor_from_config
from rfpipe.photometry.resampling import ResampledSensor, Resampling, sensor_from_description
from rfpipe.photometry.sensor import ExactSensor, MergedImages, Sensor

__all__ = [
    "CameraModel",
    "ExactSensor",
    "MergedImages",
    "ResampledSensor",
    "Resampling",
    "Sensor",
    "sensor_from_config",
    "sensor_from_description",
]
