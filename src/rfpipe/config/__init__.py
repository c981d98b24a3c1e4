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
    from rfpipe.config.capture import OfflineConfig
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
    from rfpipe.config.processing import StorageConfig
    from rfpipe.config.reading import read_yaml
    from rfpipe.config.scenes import SceneSettings

__all__ = [
    "BenchConfig",
    "CalibrationConfig",
    "CameraConfig",
    "CameraDriver",
    "Config",
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

_MODULES = {
    "calibration": ["CalibrationConfig"],
    "camera": ["CameraConfig"],
    "capture": ["OfflineConfig"],
    "devices": ["BenchConfig", "RigConfig"],
    "drivers": ["CameraDriver", "ProjectorDriver", "RigDriver"],
    "files": ["json_schema", "load_config", "load_rig_config", "parse_config", "parse_rig_config"],
    "model": ["Config"],
    "processing": ["StorageConfig"],
    "reading": ["read_yaml"],
    "scenes": ["SceneSettings"],
}
_HOMES = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'rfpipe.config' has no attribute {name!r}")
    value: object = getattr(import_module(f"rfpipe.config.{_HOMES[name]}"), name)
    globals()[name] = value
    return value
