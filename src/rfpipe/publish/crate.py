"""The crate: what each file is and how it came about, as a Workflow Run RO-Crate."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any
from urllib.parse import quote

from rfpipe.errors import StoreError, installing
from rfpipe.provenance import versions
from rfpipe.publish.citation import UNPUBLISHED, Citation

__all__ = ["METADATA_FILE", "PREVIEW_FILE", "Described", "crate_metadata", "need_rocrate"]

_PAGE = "README.md"
METADATA_FILE, PREVIEW_FILE = "ro-crate-metadata.json", "ro-crate-preview.html"

_PROFILES = {
    "https://w3id.org/ro/wfrun/process/0.5": "Process Run Crate",
    "https://w3id.org/ro/wfrun/workflow/0.5": "Workflow Run Crate",
    "https://w3id.org/workflowhub/workflow-ro-crate/1.0": "Workflow RO-Crate",
}
# used here, and not in the context of RO-Crate 1.1
_TERMS = {
    "creditText": "http://schema.org/creditText",
    "sha256": "https://w3id.org/ro/terms/workflow-run#sha256",
}
_PARAMETER = "https://bioschemas.org/profiles/FormalParameter/1.0-RELEASE"
_WORKFLOW_PROFILE = "https://bioschemas.org/profiles/ComputationalWorkflow/1.0-RELEASE"

Described = Mapping[str, Mapping[str, Any]]
"""Properties by name; the names of folders end in a slash."""


def need_rocrate() -> None:
    """Raise StoreError if ro-crate-py isn't installed."""
    try:
        import rocrate.rocrate  # noqa: F401
    except ImportError as error:
        raise StoreError(f"to publish, {installing('publish')}") from error


def crate_metadata(
    citation: Citation,
    parts: Described,
    *,
    workflow: str | None,
    settings: list[str],
    outputs: list[str],
    times: tuple[str, str],
) -> str:
    """Return a crate's metadata (JSON-LD).

    Parameters
    ----------
    citation : Citation
    parts : mapping of str to mapping
        Properties of every file and folder, by name.
    workflow : str, optional
        Name of the workflow's main file. Without one it is a Process Run Crate, rfpipe itself
        being what ran.
    settings, outputs : list of str
        Names of what the run was given, and of what it made: of parts.
    times : tuple of str
        When the run began and ended, ISO 8601.
    """
    from rocrate.rocrate import ROCrate

    crate = ROCrate(version="1.1")
    crate.metadata.extra_terms.update(_TERMS)
    for name, properties in parts.items():
        if name == workflow:
            continue
        if name.endswith("/"):
            crate.add_directory(None, name, properties=dict(properties))
        else:
            crate.add_file(None, name, properties=dict(properties))
    if _PAGE in parts:
        crate.dereference(_PAGE)["about"] = crate.root_dataset
    _describe_root(crate, citation)
    software = _add(
        crate,
        "#rfpipe",
        "SoftwareApplication",
        name="rfpipe",
        description="Acquires, stores and relights light transport.",
        softwareVersion=versions()["rfpipe"],
    )
    instrument = software
    if workflow is not None:
        instrument = _add_workflow(crate, workflow, parts[workflow], settings, outputs)
        instrument["hasPart"] = software
    profiles = dict(list(_PROFILES.items())[: 1 if workflow is None else None])
    crate.root_dataset["conformsTo"] = _one_or_all(
        [
            _add(crate, key, "CreativeWork", name=name, version=key.rpartition("/")[2])
            for key, name in profiles.items()
        ]
    )
    action = _add(
        crate,
        "#run",
        "CreateAction",
        name=f"Run of {'the workflow' if workflow else 'rfpipe'} that made these results",
        description="Patterns were shown and pictures taken, level by level, merged and refined "
        "into the light transport, which was relit and compared.",
        startTime=times[0],
        endTime=times[1],
        actionStatus="http://schema.org/CompletedActionStatus",
    )
    action["instrument"] = instrument
    action["agent"] = crate.root_dataset["creator"]
    action["object"] = _one_or_all([crate.dereference(name) for name in settings])
    action["result"] = _one_or_all([crate.dereference(name) for name in outputs])
    crate.root_dataset["mentions"] = action
    return _metadata(crate)


def _metadata(crate: Any) -> str:
    return json.dumps(crate.metadata.generate(), indent=1, ensure_ascii=False) + "\n"


def _describe_root(crate: Any, citation: Citation) -> None:
    root = crate.root_dataset
    root["name"] = citation.title
    root["description"] = citation.description
    root["datePublished"] = citation.published.isoformat()
    root["version"] = citation.version
    root["keywords"] = ", ".join(citation.keywords)
    root["license"] = _add(
        crate,
        citation.license_url,
        "CreativeWork",
        name=citation.license,
        description=f"The licence {citation.license}.",
        url=citation.license_url,
    )
    creators = [
        _add(
            crate,
            f"https://orcid.org/{creator.orcid}" if creator.orcid else f"#creator-{number}",
            "Person" if "," in creator.name or creator.orcid else "Organization",
            name=creator.name,
            **(
                {"affiliation": _organization(crate, creator.affiliation)}
                if creator.affiliation
                else {}
            ),
        )
        for number, creator in enumerate(citation.creators, 1)
    ]
    root["creator"] = root["author"] = _one_or_all(creators)
    root["creditText"] = citation.text
    if citation.publisher != UNPUBLISHED:
        root["publisher"] = _organization(crate, citation.publisher)
    if citation.doi:
        root["identifier"] = f"https://doi.org/{citation.doi}"


def _organization(crate: Any, name: str) -> Any:
    key = f"#{quote(name)}"
    return crate.dereference(key) or _add(crate, key, "Organization", name=name)


def _add_workflow(
    crate: Any,
    workflow: str,
    properties: Mapping[str, Any],
    settings: list[str],
    outputs: list[str],
) -> Any:
    main = crate.add_workflow(
        None, workflow, main=True, lang="snakemake", properties=dict(properties)
    )
    main["conformsTo"] = _add(
        crate, _WORKFLOW_PROFILE, "CreativeWork", name="ComputationalWorkflow"
    )
    main["version"] = versions()["rfpipe"]
    main["license"] = "https://spdx.org/licenses/MIT"
    profile = _add(crate, _PARAMETER, "CreativeWork", name="FormalParameter")
    for term, names in (("input", settings), ("output", outputs)):
        parameters = []
        for number, name in enumerate(names, 1):
            part = crate.dereference(name)
            is_folder = name.endswith("/")
            parameter = _add(
                crate,
                f"#{term}-{number}",
                "FormalParameter",
                name=name.strip("/"),
                description=part.get("description", name),
                additionalType="Dataset" if is_folder else "File",
                valueRequired=term == "input",
            )
            parameter["conformsTo"] = profile
            parameter["workExample"] = part
            part["exampleOfWork"] = parameter
            parameters.append(parameter)
        main[term] = _one_or_all(parameters)
    return main


def _add(crate: Any, key: str, kind: str, **properties: Any) -> Any:
    from rocrate.model.contextentity import ContextEntity

    return crate.add(ContextEntity(crate, key, properties={"@type": kind, **properties}))


def _one_or_all(entities: list[Any]) -> Any:
    """Return a property's value: a list only where there are several, or none."""
    return entities[0] if len(entities) == 1 else entities
