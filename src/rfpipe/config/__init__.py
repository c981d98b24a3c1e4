"""The settings of a run, and those of a rig: pydantic models, read from YAML.

``python -m rfpipe.config`` writes the default files and the JSON schemas from the models.
"""

from rfpipe.config.calibration import CalibrationConfig
from rfpipe.config.camera import CameraConfig
from rfpipe.config.devices import BenchConfig, RigConfig
from rfpipe.config.drivers import CameraDriver, ProjectorDriver, RigDriver
from rfpipe.config.files import (
    default_yaml,
    json_schema,
    load_config,
    load_rig_config,
    parse_config,
    parse_rig_config,
)
from rfpipe.config.model import Config
from rfpipe.config.offline import OfflineConfig
from rfpipe.config.processing import NumberFormat, StorageConfig
from rfpipe.config.reading import read_yaml
from rfpipe.config.scenes import SceneSettings

__all__ = [
    "BenchConfig",
    "CalibrationConfig",
    "CameraConfig",
    "CameraDriver",
    "Config",
    "NumberFormat",
    "OfflineConfig",
    "ProjectorDriver",
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
    "read_yaml",
]
