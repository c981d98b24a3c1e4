"""The crate: what each file is and how it came about, as a Workflow Run RO-Crate."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any
from urllib.parse import quote

from rfpipe.provenance import versions
from rfpipe_publish.citation import UNPUBLISHED, Citation

METADATA_FILE = "ro-crate-metadata.json"

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
_BIOSCHEMAS = "https://bioschemas.org/profiles"


def crate_metadata(
    citation: Citation,
    parts: Mapping[str, Mapping[str, Any]],
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
        Properties of every file and folder, by name; the names of folders end in a slash.
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
        if name != workflow:
            add = crate.add_directory if name.endswith("/") else crate.add_file
            add(None, name, properties=dict(properties))
    root = crate.root_dataset
    crate.dereference("README.md")["about"] = root
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
    profiles = list(_PROFILES.items())[: 1 if workflow is None else None]
    root["conformsTo"] = _one_or_all(
        [
            _add(crate, key, "CreativeWork", name=name, version=key.rpartition("/")[2])
            for key, name in profiles
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
    action["agent"] = root["creator"]
    action["object"] = _one_or_all([crate.dereference(name) for name in settings])
    action["result"] = _one_or_all([crate.dereference(name) for name in outputs])
    root["mentions"] = action
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
    creators = []
    for number, creator in enumerate(citation.creators, 1):
        kind = "Person" if creator.is_person else "Organization"
        entity = _add(crate, creator.orcid_url or f"#creator-{number}", kind, name=creator.name)
        if creator.affiliation:
            entity["affiliation"] = _organization(crate, creator.affiliation)
        creators.append(entity)
    root["creator"] = root["author"] = _one_or_all(creators)
    root["creditText"] = citation.text
    if citation.publisher != UNPUBLISHED:
        root["publisher"] = _organization(crate, citation.publisher)
    if citation.doi:
        root["identifier"] = citation.doi_url


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
    key = f"{_BIOSCHEMAS}/ComputationalWorkflow/1.0-RELEASE"
    main["conformsTo"] = _add(crate, key, "CreativeWork", name="ComputationalWorkflow")
    main["version"] = versions()["rfpipe"]
    main["license"] = "https://spdx.org/licenses/MIT"
    key = f"{_BIOSCHEMAS}/FormalParameter/1.0-RELEASE"
    profile = _add(crate, key, "CreativeWork", name="FormalParameter")
    for term, names in (("input", settings), ("output", outputs)):
        parameters = []
        for number, name in enumerate(names, 1):
            part = crate.dereference(name)
            parameter = _add(
                crate,
                f"#{term}-{number}",
                "FormalParameter",
                name=name.strip("/"),
                description=part.get("description", name),
                additionalType="Dataset" if name.endswith("/") else "File",
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
