"""The section on camera, scenes and versions."""

from __future__ import annotations

from typing import Any

import numpy as np

from rfpipe.provenance import versions
from rfpipe.report.blocks import Block, Section, Table, Tabulation
from rfpipe.report.inputs import Inputs
from rfpipe.report.text import ray_size, words


def setup_section(inputs: Inputs) -> Section:
    """Camera, scenes and versions."""
    config = inputs.config
    blocks: list[Block] = []
    if config.capture.rig != "simulated":
        text = [_REMOTE]
    elif config.camera is None:
        text = ["The camera is ideal: exact radiance, no noise."]
    else:
        text = [_CAMERA]
        blocks.append(_settings("Noise model", _UNITS, config.camera.model_dump(mode="json")))
    scenes = Table(
        [],
        ["scene", "kind", "rays", "channels", "options"],
        [
            [name, scene.kind, ray_size(scene), str(scene.channels), _listed(scene.own_options())]
            for name, scene in config.scenes.items()
        ],
        text_columns=2,
    )
    about = (
        "Simulated scenes before pinhole rigs; ground truth by exact transport."
        if inputs.has_truth
        else "A real scene; its ground truth is unknown."
    )
    acquisition = {
        "seed": config.seed,
        **{
            f"{name}.{option}": value
            for name, section in config.methods.items()
            for option, value in section.options().items()
        },
        **config.capture.model_dump(mode="json", exclude={"url", "token_file", "patience_seconds"}),
        **config.merge.model_dump(mode="json"),
        "normalization": config.normalization,
    }
    blocks += [
        Tabulation("Scenes", about, scenes),
        _settings("Acquisition", {"seconds_per_pattern": "s"}, acquisition),
        _settings("Versions", {}, versions()),
    ]
    return Section("setup", "Camera, scenes and versions", blocks, text)


_REMOTE = (
    "The pictures were taken by a real rig, or one served like one. Its projector, camera and "
    "calibration are described in L00/capture.json beside each acquisition's results."
)

_CAMERA = (
    "The simulated camera takes a bracket of each pattern. Photon shot noise, dark current, read "
    "noise and the converter's rounding enter each exposure; brackets are merged by maximum "
    "likelihood, with the variance that every later decision uses."
)

_UNITS = {
    "exposures": "s",
    "electrons_per_radiance": "electrons a second at radiance 1",
    "full_well_electrons": "electrons",
    "read_noise_electrons": "electrons RMS",
    "dark_current_electrons": "electrons a second",
    "black_level_counts": "counts",
    "psf_sigma": "pixels",
}


def _listed(options: dict[str, Any]) -> str:
    """Show options in a line, without those that are empty."""
    told = []
    for name, value in options.items():
        words, _, unit = name.rpartition("_")
        if unit == "degrees":
            told.append(f"{words} " + " by ".join(f"{angle:g}°" for angle in np.atleast_1d(value)))
        elif value not in (None, []):
            told.append(f"{name.replace('_', ' ')} {_shown(value)}")
    return "; ".join(told)


def _settings(name: str, units: dict[str, str], values: dict[str, Any]) -> Tabulation:
    """Show settings as names and values with their units."""
    rows = [
        [words(key), f"{_shown(value)} {units.get(key, '')}".rstrip()]
        for key, value in values.items()
    ]
    return Tabulation(name, "", Table([], ["", "value"], rows, text_columns=2))


def _shown(value: Any) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(_shown(item) for item in value)
    if isinstance(value, dict):
        return ", ".join(f"{name.replace('_', ' ')} {_shown(it)}" for name, it in value.items())
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "none" if value is None else words(value)
