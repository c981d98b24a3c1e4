"""Settings of a rig that affect its light and its frames, and their comparison.

A calibration records them; after a change, the rig needs a new calibration.
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
    "calibrate": True,  # added for each step, see `rfpipe.calibration.run`
    "calibration": True,
    "seconds_per_pattern": True,  # for estimates only
    "bench": {"knock"},  # simulates an event after the calibration
}

_CODE = ".driver: its code"

_MOST_LINES = 12


def shaping_settings(config: RigConfig) -> Flat:
    """Settings of a rig that affect its light and its frames, and digests of users' drivers."""
    plain = config.model_dump(mode="json", exclude=_WITHOUT_EFFECT)
    for name, device in (("projector", config.projector), ("camera", config.camera)):
        for option in type(device.options).without_effect_on_frames:
            plain[name]["options"].pop(option, None)
        plain |= _code_of(name, device)
    return flat(plain)


def _code_of(name: str, device: DeviceDriver) -> Flat:
    """Digest of a driver's code; empty for a driver of rfpipe."""
    if plugins.is_of_rfpipe(device.group, device.driver):
        return {}
    return {f"{name}{_CODE}": source_digest(*plugins.sources_of(device.group, device.driver))}


def is_of_a_step(name: str) -> bool:
    """Test whether a setting affects some steps of a calibration only, as ``calibrate.codes``."""
    return name in (RAYS, SETTLE) or name.startswith("calibrate.")


def settings_of_all_steps(settings: Mapping[str, Any]) -> Flat:
    """Select the settings that affect every step of a calibration."""
    return {name: value for name, value in settings.items() if not is_of_a_step(name)}


def identities(devices: Mapping[str, Any]) -> Flat:
    """Select models and serial numbers from descriptions of devices.

    Parameters
    ----------
    devices : mapping
        Descriptions by dotted names, such as ``camera.serial``.
    """
    return {name: value for name, value in devices.items() if name.endswith((".model", ".serial"))}


def flat(groups: Mapping[str, Any], prefix: str = "") -> Flat:
    """Flatten nested settings to dotted names; empty groups disappear."""
    values: Flat = {}
    for name, value in groups.items():
        if isinstance(value, Mapping):
            values |= flat(value, f"{prefix}{name}.")
        else:
            values[f"{prefix}{name}"] = value
    return values


def differences(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Describe each setting whose value changed, in one line: its name and both values.

    A missing setting is equal to null, so that an option added by a newer driver is no
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
