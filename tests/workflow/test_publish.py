"""A published run, checked by the validators of each format, without network."""

import importlib.resources
import json
import shutil
import subprocess
import zipfile
from datetime import date
from pathlib import Path

import numpy as np
import pytest
from tests.rigs.known_matrix import contents
from tests.workflow.harness import GLASS, OWN_METHODS, ROOT, Workflow

import rfpipe
from rfpipe.pictures.images import read_image
from rfpipe.publishing.metadata import Citation
from rfpipe.publishing.publication import publish
from rfpipe.publishing.run import find_run
from rfpipe.references.reference_images import read_floodlit
from rfpipe.storage.files import FolderStorage

_VALIDATE_CRATE = """
import sys, json, responses
from rocrate_validator import models, services
crate, context, cache, profile = sys.argv[1:]
with responses.RequestsMock(assert_all_requests_are_fired=False) as web:
    web.add("GET", "https://w3id.org/ro/crate/1.1/context", body=open(context).read(),
            content_type="application/ld+json")
    settings = services.ValidationSettings(
        rocrate_uri=crate, profile_identifier=profile, cache_path=cache,
        requirement_severity=models.Severity.REQUIRED)
    found = services.validate(settings)
issues = [f"{issue.check.identifier}: {issue.message}" for issue in found.get_issues()]
print(json.dumps([found.passed(), issues]))
"""


@pytest.fixture(scope="module")
def crate(undisturbed: Workflow, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a published run, unpacked from the zip file next to it."""
    citation = Citation.model_validate(
        {
            "title": "Two wedges",
            "description": "Light transport of two wedges.",
            "creators": [{"name": "Doe, Jane", "affiliation": "A Lab"}],
            "license": "CC-BY-4.0",
            "published": date(2026, 11, 22),
        },
    )
    folder = tmp_path_factory.mktemp("publication") / "crate"
    packed = folder.with_suffix(".zip")
    publish(find_run(undisturbed.folder), citation, packed, config=undisturbed.config)
    with zipfile.ZipFile(packed) as archive:
        archive.extractall(folder)
    return folder


def printed(python: str, script: str, *arguments: object) -> object:
    """Run a script and return its last line of output, parsed as JSON."""
    command = [python, "-W", "ignore", "-c", script, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_the_publication_is_a_workflow_run_crate(
    crate: Path, tmp_path: Path, validators: str
) -> None:
    source = importlib.resources.files("rocrate").joinpath("data/ro-crate.jsonld")
    # included in ro-crate-py in a later version that moved or added these terms
    context = json.loads(source.read_text())
    context["@context"]["ComputationalWorkflow"] = "https://bioschemas.org/ComputationalWorkflow"
    del context["@context"]["creditText"], context["@context"]["sha256"]
    (tmp_path / "context.json").write_text(json.dumps(context))
    arguments = (tmp_path / "context.json", tmp_path / "cache", "workflow-run-crate")
    assert printed(validators, _VALIDATE_CRATE, crate.with_suffix(".zip"), *arguments) == [True, []]


def test_datacite_is_valid(crate: Path, validators: str) -> None:
    script = (
        "import json, sys; from datacite import schema45; "
        "schema45.validator.validate(json.load(open(sys.argv[1]))); print(1)"
    )
    assert printed(validators, script, crate / "datacite.json") == 1


def test_the_graph_lists_every_file_with_its_provenance(crate: Path) -> None:
    graph = json.loads((crate / "ro-crate-metadata.json").read_text())["@graph"]
    entities = {entity["@id"]: entity for entity in graph}
    parts = {part["@id"] for part in entities["./"]["hasPart"]}
    files = {file.relative_to(crate).as_posix() for file in crate.rglob("*") if file.is_file()}
    made_last = {"ro-crate-metadata.json", "ro-crate-preview.html", "manifest-sha256.txt"}
    loose = {name for name in files if ".zarr/" not in name} - made_last
    assert loose == {name for name in parts if not name.endswith("/")}
    stores = {name for name in parts if name.endswith(".zarr/")}
    assert {result["@id"] for result in entities["#run"]["result"]} == stores
    assert len(stores) == 3
    assert entities["#run"]["instrument"]["@id"] == "source/Snakefile"
    assert (crate / "source/Snakefile").read_bytes() == (ROOT / "Snakefile").read_bytes()
    assert entities["#run"]["startTime"] <= entities["#run"]["endTime"]


@pytest.mark.slow
def test_a_run_with_user_code_can_be_repeated_from_its_crate(tmp_path: Path, kernels: None) -> None:
    original, repeated, crate = Workflow(tmp_path / "first"), tmp_path / "again", tmp_path / "crate"
    for name in ("column_scan.py", "frosted_glass.py"):
        shutil.copy(ROOT / "tests/examples" / name, original.folder)
    original.configure(
        scenes={"glass": GLASS},
        methods={"module": OWN_METHODS["module"]},
        camera=None,
        resources={"jobs": "acquisition"},
    )
    original.run("results/glass/module/transport.json")
    facts = {"title": "a", "creators": ["Doe, Jane"], "license": "MIT", "published": "2026-01-01"}
    citation = Citation.model_validate(facts)
    written = publish(find_run(original.folder), citation, crate, config=original.config)
    assert written.notes == []
    shutil.rmtree(original.folder)
    shutil.copytree(crate / "inputs", repeated)
    (repeated / "config.yaml").write_bytes((crate / "settings.yaml").read_bytes())
    second = Workflow(repeated)
    second.run("results/glass/module/transport.json")
    transport = "glass/module/transport.zarr"
    assert contents(second.path(transport)) == contents(crate / "results" / transport)


def test_published_pictures_and_transports_equal_those_of_the_run(
    crate: Path, undisturbed: Workflow
) -> None:
    floodlit, _ = read_floodlit(FolderStorage(undisturbed.path("tiny/dual")))
    assert np.array_equal(read_image(crate / "pictures/tiny/dual/floodlit.exr"), floodlit)
    name = "results/long/brute_force/transport.zarr"
    light = np.random.default_rng(0).random((5, 8), np.float32)
    relit = rfpipe.open_transport(crate / name).relight(light)
    assert np.array_equal(rfpipe.open_transport(undisturbed.folder / name).relight(light), relit)
