"""What a report was made from: settings, versions and digests."""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Iterator, Mapping
from typing import Any

from rfpipe.provenance import fingerprint, versions
from rfpipe.report.inputs import Inputs, Run
from rfpipe.report.page import Section, Table
from rfpipe.report.text import plain


def setup_section(inputs: Inputs) -> Section:
    """Settings, with what scenes choose for those that are null, and versions."""
    names = ["setting", "value"]
    settings = [[name, str(value)] for name, value in _flat(inputs.config.shaping())]
    packages = [[name, version] for name, version in _versions(inputs).items()]
    tables = [
        *_choices_table(inputs),
        Table("Settings", "As config/all.yaml describes them.", names, settings, 2),
        Table("Versions", "", ["package", "version"], packages, 2),
    ]
    return Section("setup", "Settings and versions", tables)


def _choices_table(inputs: Inputs) -> list[Table]:
    """Return the table of what scenes choose for settings that are null, if any does."""
    rows = [
        [scene, choice["setting"], plain(choice["value"]), choice["reason"]]
        for scene in inputs.scenes
        for choice in inputs.light_of(scene).get("choices", [])
    ]
    names = ["scene", "setting", "value", "reason"]
    caption = "Settings that are null, and what the scene chooses for them."
    return [Table("Chosen by scenes", caption, names, rows, 4, is_folded=False)] if rows else []


def _versions(inputs: Inputs) -> dict[str, str]:
    """Return the versions of what made the report, and of what recorded its scenes."""
    recorded = [run.facts.get("recorded", {}).get("versions", {}) for run in inputs.runs]
    return dict(ChainMap(versions(), *recorded))


def _flat(settings: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the settings that have a value, by their dotted names."""
    for name, value in settings.items():
        if isinstance(value, Mapping) and value:
            yield from _flat(value, f"{prefix}{name}.")
        elif value not in (None, [], {}):
            yield f"{prefix}{name}", value


def provenance_of(inputs: Inputs) -> dict[str, Any]:
    """Return plain data that tells a report's origin."""
    shaping = inputs.config.shaping()
    return {
        "versions": _versions(inputs),
        "seed": inputs.config.seed,
        "configuration": shaping,
        "configuration_fingerprint": fingerprint(shaping),
        "acquisitions": [_acquisition(run) for run in inputs.runs],
    }


def _acquisition(run: Run) -> dict[str, Any]:
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
        "verification": verified or None,
    }
