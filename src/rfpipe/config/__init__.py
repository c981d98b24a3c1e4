"""The settings of a run: one pydantic model, read from YAML, which also makes its own defaults.

``python -m rfpipe.config`` writes the default file and the JSON schema from the model.
"""

from rfpipe.config.files import default_yaml, json_schema, load_config, parse_config
from rfpipe.config.model import (
    AcquisitionConfig,
    CameraConfig,
    CaptureConfig,
    Config,
    MergeConfig,
    MethodName,
    Normalization,
    NumberFormat,
    OccluderConfig,
    ReportConfig,
    ResourcesConfig,
    SceneConfig,
    StorageConfig,
    Surface,
)

__all__ = [
    "AcquisitionConfig",
    "CameraConfig",
    "CaptureConfig",
    "Config",
    "MergeConfig",
    "MethodName",
    "Normalization",
    "NumberFormat",
    "OccluderConfig",
    "ReportConfig",
    "ResourcesConfig",
    "SceneConfig",
    "StorageConfig",
    "Surface",
    "default_yaml",
    "json_schema",
    "load_config",
    "parse_config",
]
