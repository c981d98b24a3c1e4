"""The settings of a run, and those of a rig: pydantic models, read from YAML.

``python -m rfpipe.config`` writes from the models what is made of them. Each name
is imported when it is first used: a job needs few of the models, and to load all takes as long as
the work of a small one.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rfpipe.config.calibration import CalibrationConfig
    from rfpipe.config.camera import CameraConfig
    from rfpipe.config.devices import BenchConfig, RigConfig
    from rfpipe.config.drivers import CameraDriver, ProjectorDriver, RigDriver
    from rfpipe.config.files import (
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
    "json_schema",
    "load_config",
    "load_rig_config",
    "parse_config",
    "parse_rig_config",
    "read_yaml",
]

_HOMES = {
    "BenchConfig": "rfpipe.config.devices",
    "CalibrationConfig": "rfpipe.config.calibration",
    "CameraConfig": "rfpipe.config.camera",
    "CameraDriver": "rfpipe.config.drivers",
    "Config": "rfpipe.config.model",
    "NumberFormat": "rfpipe.config.processing",
    "OfflineConfig": "rfpipe.config.offline",
    "ProjectorDriver": "rfpipe.config.drivers",
    "RigConfig": "rfpipe.config.devices",
    "RigDriver": "rfpipe.config.drivers",
    "SceneSettings": "rfpipe.config.scenes",
    "StorageConfig": "rfpipe.config.processing",
    "json_schema": "rfpipe.config.files",
    "load_config": "rfpipe.config.files",
    "load_rig_config": "rfpipe.config.files",
    "parse_config": "rfpipe.config.files",
    "parse_rig_config": "rfpipe.config.files",
    "read_yaml": "rfpipe.config.reading",
}


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'rfpipe.config' has no attribute {name!r}")
    value: object = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value
