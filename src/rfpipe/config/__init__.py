"""The settings of a run, and those of a rig: pydantic models, read from YAML.

``python -m rfpipe.config`` writes the default files and the JSON schemas from the models.
"""

from rfpipe.config.base import MethodSettings
from rfpipe.config.calibration import CalibrationConfig
from rfpipe.config.devices import (
    BenchConfig,
    RigConfig,
)
from rfpipe.config.drivers import CameraDriver, ProjectorDriver, RigDriver
from rfpipe.config.files import (
    default_yaml,
    json_schema,
    load_config,
    load_rig_config,
    parse_config,
    parse_rig_config,
)
from rfpipe.config.model import (
    CameraConfig,
    CaptureConfig,
    Config,
    MergeConfig,
    Normalization,
    NumberFormat,
    ReportConfig,
    ResourcesConfig,
    StorageConfig,
)
from rfpipe.config.scenes import SceneSettings

__all__ = [
    "BenchConfig",
    "CalibrationConfig",
    "CameraConfig",
    "CameraDriver",
    "CaptureConfig",
    "Config",
    "MergeConfig",
    "MethodSettings",
    "Normalization",
    "NumberFormat",
    "ProjectorDriver",
    "ReportConfig",
    "ResourcesConfig",
    "RigConfig",
    "RigDriver",
    "SceneSettings",
    "StorageConfig",
    "default_yaml",
    "json_schema",
    "load_config",
    "load_rig_config",
    "parse_config",
    "parse_rig_config",
]
