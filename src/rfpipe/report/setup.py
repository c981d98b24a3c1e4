"""Origin of a report: settings, rigs, versions and digests."""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Iterator, Mapping, Set
from typing import Any

from rfpipe.provenance import fingerprint, versions
from rfpipe.report.inputs import RelitAcquisition, ReportInputs, rig_of
from rfpipe.report.page import Section, Table
from rfpipe.report.text import setting_text
from rfpipe.rigs.calibrated import VERDICTS_KEY
from rfpipe.rigs.settings import flat
from rfpipe.storage.files import FolderStorage
from rfpipe.storage.picture_counts import captured_pictures


def setup_section(inputs: ReportInputs) -> Section:
    """Return the section of settings, values that scenes choose for null, rigs, and versions."""
    names = ["setting", "value"]
    shaping = inputs.config.result_settings()
    shaping = _without_idle_methods(shaping, {run.method for run in inputs.runs})
    caption = "config/all.yaml describes them; methods that did not run are omitted."
    if inputs.config.capture.rig == "remote":
        # the camera of the settings belongs to simulated and offline rigs
        shaping = {name: value for name, value in shaping.items() if name != "camera"}
        caption += " The camera is described with the rig, below."
    settings = [[name, str(value)] for name, value in _with_values(shaping)]
    packages = [[name, version] for name, version in _versions(inputs).items()]
    tables = [
        *_choices_table(inputs),
        Table("Settings", caption, names, settings, 2),
        *_rig_tables(inputs),
        Table(
            "Versions",
            "Packages by which the report was made.",
            ["package", "version"],
            packages,
            2,
        ),
    ]
    return Section("setup", "Settings and versions", tables)


def _without_idle_methods(settings: Mapping[str, Any], ran: Set[str]) -> dict[str, Any]:
    """Return settings of the run and of its scenes without the methods that did not run."""

    def without_idle(group: Mapping[str, Any]) -> dict[str, Any]:
        methods = group.get("methods") or {}
        return {**group, "methods": {name: it for name, it in methods.items() if name in ran}}

    scenes = {name: without_idle(scene) for name, scene in settings.get("scenes", {}).items()}
    return {**without_idle(settings), "scenes": scenes}


def _choices_table(inputs: ReportInputs) -> list[Table]:
    """Return the table of values that scenes choose for null settings, in a list, or none."""
    rows = [
        [scene, choice["setting"], setting_text(choice["value"]), choice["reason"]]
        for scene in inputs.scenes
        for choice in inputs.light_of(scene).get("choices", [])
    ]
    names = ["scene", "setting", "value", "reason"]
    caption = "Values that a scene chooses for settings that are null."
    return [Table("Chosen by scenes", caption, names, rows, 4, is_folded=False)] if rows else []


def _rig_tables(inputs: ReportInputs) -> Iterator[Table]:
    """Yield the description of devices and sensor of each rig that isn't simulated."""
    groups: dict[str, list[str]] = {}
    rigs: dict[str, dict[str, Any]] = {}
    for run in inputs.runs:
        rig = rig_of(inputs.results, run)
        if not rig or rig.get("kind") == "simulated":
            continue
        devices = {name: it for name, it in rig.items() if name not in ("sensor", VERDICTS_KEY)}
        described = {"sensor": _camera_of(rig.get("sensor", {})), **devices}
        key = fingerprint(described)
        rigs[key] = described
        groups.setdefault(key, []).append(f"{run.scene} by {run.method}")
    for number, (key, runs) in enumerate(groups.items(), 1):
        name = "Rig" if len(groups) == 1 else f"Rig {number}"
        rows = [[fact, str(value)] for fact, value in _with_values(rigs[key])]
        caption = f"Description by the rig at the capture of {', '.join(runs)}."
        yield Table(name, caption, ["fact", "value"], rows, 2)


def _camera_of(sensor: Mapping[str, Any]) -> dict[str, Any]:
    """Return the description of a sensor's camera; a resampled sensor contains another one."""
    return _camera_of(sensor["sensor"]) if "sensor" in sensor else dict(sensor)


def _versions(inputs: ReportInputs) -> dict[str, str]:
    """Return the versions of the packages that made the report or recorded its scenes."""
    recorded = [run.facts.get("recorded", {}).get("versions", {}) for run in inputs.runs]
    return dict(ChainMap(versions(), *recorded))


def _with_values(settings: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield dotted name and value of the settings that aren't null or empty."""
    yield from ((name, value) for name, value in flat(settings).items() if value not in (None, []))


def provenance_of(inputs: ReportInputs) -> dict[str, Any]:
    """Return the origin of a report as plain data."""
    shaping = inputs.config.result_settings()
    return {
        "versions": _versions(inputs),
        "seed": inputs.config.seed,
        "configuration": shaping,
        "configuration_fingerprint": fingerprint(shaping),
        "acquisitions": [_acquisition(inputs, run) for run in inputs.runs],
    }


def _acquisition(inputs: ReportInputs, run: RelitAcquisition) -> dict[str, Any]:
    storage = FolderStorage(inputs.results / run.scene / run.method)
    verified = {name: run.verified[name] for name in ("mean_error", "worst_error") if run.verified}
    return {
        "scene": run.scene,
        "method": run.method,
        "options": run.facts["options"],
        "light": run.facts.get("light", {}),
        "versions": run.facts.get("versions", {}),
        "transport_digest": run.acquired.get("digest"),
        "relit_digest": run.images.digest,
        "patterns": run.patterns,
        "pictures": captured_pictures(storage).total,
        "verification": verified or None,
    }
