"""The settings of a run, and those of a rig: pydantic models, read from YAML.

Each name is imported when it is first used: a job needs few of the models, and to load all takes
as long as the work of a small one.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rfpipe.config.camera import CameraConfig as CameraConfig
    from rfpipe.config.capture import OfflineConfig as OfflineConfig
    from rfpipe.config.capture import StorageConfig as StorageConfig
    from rfpipe.config.devices import BenchConfig as BenchConfig
    from rfpipe.config.devices import CalibrationConfig as CalibrationConfig
    from rfpipe.config.devices import LensConfig as LensConfig
    from rfpipe.config.devices import RigConfig as RigConfig
    from rfpipe.config.files import load_camera as load_camera
    from rfpipe.config.files import load_config as load_config
    from rfpipe.config.files import load_rig_config as load_rig_config
    from rfpipe.config.files import parse_config as parse_config
    from rfpipe.config.files import parse_rig_config as parse_rig_config
    from rfpipe.config.model import Config as Config
    from rfpipe.config.reading import read_yaml as read_yaml
    from rfpipe.config.scenes import Choice as Choice
    from rfpipe.config.scenes import SceneSettings as SceneSettings

_MODULES = {
    "camera": ["CameraConfig"],
    "capture": ["OfflineConfig", "StorageConfig"],
    "devices": ["BenchConfig", "CalibrationConfig", "LensConfig", "RigConfig"],
    "files": [
        "load_camera", "load_config", "load_rig_config", "parse_config", "parse_rig_config",
    ],
    "model": ["Config"],
    "reading": ["read_yaml"],
    "scenes": ["Choice", "SceneSettings"],
}  # fmt: skip
_HOMES = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'rfpipe.config' has no attribute {name!r}")
    value: object = getattr(import_module(f"rfpipe.config.{_HOMES[name]}"), name)
    globals()[name] = value
    return value
