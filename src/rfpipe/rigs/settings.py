"""Settings of a rig's file that shape its light and its frames, and how two sets of them differ.

A calibration records them. A rig whose settings changed afterwards needs a new calibration.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from rfpipe import plugins
from rfpipe.config.mistakes import yaml_text
from rfpipe.provenance import source_digest

if TYPE_CHECKING:
    from rfpipe.config import RigConfig
    from rfpipe.config.drivers import DeviceDriver

Flat = dict[str, Any]
"""Plain values by the names of their settings, such as ``sensor.bits``."""

RAYS = "rays"
SETTLE = "projector.options.settle_seconds"

_WITHOUT_EFFECT: Any = {
    "calibrate": True,  # added step by step, see `rfpipe.calibration.run`
    "calibration": True,
    "seconds_per_pattern": True,  # for estimates
    "bench": {"knock"},  # an event: rehearsed after the calibration
}

_CODE = ".driver: its code"

_MOST_LINES = 12


def shaping_settings(config: RigConfig) -> Flat:
    """Return the settings of a rig that shape its light and its frames, and its drivers' code.

    The code counts of drivers that aren't rfpipe's: a digest of the file of the class.
    """
    plain = config.model_dump(mode="json", exclude=_WITHOUT_EFFECT)
    for name, device in (("projector", config.projector), ("camera", config.camera)):
        for option in type(device.options).without_effect_on_frames:
            plain[name]["options"].pop(option, None)
        plain |= _code_of(name, device)
    return flat(plain)


def _code_of(name: str, device: DeviceDriver) -> Flat:
    """Return the digest of a driver's code; nothing for a driver of rfpipe."""
    if plugins.is_of_rfpipe(device.group, device.driver):
        return {}
    return {f"{name}{_CODE}": source_digest(*plugins.sources_of(device.group, device.driver))}


def is_of_a_step(name: str) -> bool:
    """Test whether a setting shapes only some steps of a calibration: ``calibrate.codes``."""
    return name in (RAYS, SETTLE) or name.startswith("calibrate.")


def settings_of_all_steps(settings: Mapping[str, Any]) -> Flat:
    """Return the settings that shape every step of a calibration."""
    return {name: value for name, value in settings.items() if not is_of_a_step(name)}


def identities(devices: Mapping[str, Any]) -> Flat:
    """Return the models and serial numbers in descriptions of devices.

    Parameters
    ----------
    devices : mapping
        Descriptions by dotted names, such as ``camera.serial``.
    """
    return {name: value for name, value in devices.items() if name.endswith((".model", ".serial"))}


def flat(groups: Mapping[str, Any], prefix: str = "") -> Flat:
    """Return nested settings by dotted names; an empty group has none."""
    values: Flat = {}
    for name, value in groups.items():
        if isinstance(value, Mapping):
            values |= flat(value, f"{prefix}{name}.")
        else:
            values[f"{prefix}{name}"] = value
    return values


def differences(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Return a line for each setting whose value changed: its name and both values.

    A setting that is missing counts as null, so that an option which a newer driver adds is no
    change.
    """
    lines = []
    for name in dict.fromkeys([*before, *now]):
        old, new = before.get(name), now.get(name)
        if old == new:
            continue
        if name.endswith(_CODE):
            lines.append(f"{name} changed")
        else:
            lines.append(f"{name} was {yaml_text(old)}, is now {yaml_text(new)}")
    if len(lines) > _MOST_LINES:
        lines[_MOST_LINES:] = [f"... and {len(lines) - _MOST_LINES} more"]
    return lines
