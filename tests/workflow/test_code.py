"""The code behind each stage: what counts for its result, and what an edit of it makes again."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from tests.workflow.harness import DUAL, TINY, Workflow

import rfpipe
from rfpipe.methods import method_names
from rfpipe.plugins import METHODS, SCENES
from rfpipe.stages.jobs.code import (
    MERGED_WITH,
    SHAPELESS,
    module_of,
    stage_modules,
)
from rfpipe.store import read_manifest

KINDS = "rfpipe.scenes.kinds"

# Runs each stage in a process of its own, forked before any of rfpipe is loaded, and tells what it
# loaded; outside packages are loaded once.
PROGRAM = r"""
import importlib, json, os, sys
from pathlib import Path

import numba, numpy, pandas, pydantic, scipy.sparse, zarr

loaded, folder, config_file, results = {}, Path(sys.argv[1]), sys.argv[2], Path(sys.argv[3])


def stage(name, work):
    reader, writer = os.pipe()
    if not os.fork():
        work(importlib.import_module(f"rfpipe.{name}"))
        names = [name for name in sys.modules if name.startswith("rfpipe")]
        os.write(writer, json.dumps(names).encode())
        os._exit(0)
    os.close(writer)
    with os.fdopen(reader) as told:
        loaded.setdefault(name, set()).update(json.loads(told.read()))


def files():
    from rfpipe.stages.folder import AcquisitionFolder

    return AcquisitionFolder(folder)


def planned():
    from rfpipe.stages.plan import Plan

    return Plan("symmetric", "symmetric", (4, 5), (4, 5), 1), files()


def level(number):
    def capture(module):
        from rfpipe.photometry import CameraModel
        from rfpipe.rigs import OperatorRig

        matrix = numpy.random.default_rng(1).random((20, 20)) / 40
        rig = OperatorRig(matrix + matrix.T, (4, 5), (4, 5), CameraModel())
        module.run(rig, files(), number, references=(2, 2), drift_patterns=2)

    def merge(module):
        from rfpipe.stages.capturing.sensors import read_sensor

        module.run(
            read_sensor(files()), files(), number, saturation_fraction=0.98, mask_defects=True,
            code="", divide_out_drift=True,
        )

    stage("stages.schedule", lambda module: module.run(*planned(), number, ""))
    stage("stages.capture", capture)
    stage("stages.merge", merge)
    stage(
        "stages.normalize",
        lambda module: module.run(*planned(), number, mode="per_channel", code=""),
    )
    stage("stages.refine", lambda module: module.run(*planned(), number, ""))


for number in range(4):
    level(number)


def assemble(module):
    module.run(*planned(), folder / "transport.json", "matrix", "uint8", "")


def config():
    from rfpipe.config import load_config

    return load_config(config_file)


stage("stages.assemble", assemble)
of_tiny = results / "tiny" / "symmetric"
stage("stages.relight", lambda module: module.run(of_tiny, config().scenes["tiny"], ""))
stage(
    "stages.evaluating.sweep",
    lambda module: module.run(config(), "tiny", "symmetric", of_tiny, ""),
)
study = results / "studies" / "resolution.json"
stage(
    "stages.evaluating.studies", lambda module: module.run("resolution", config(), study, "")
)
tables = [folder / "errors.csv", folder / "speed_error.csv"]
stage(
    "stages.evaluating.evaluate",
    lambda module: module.run([of_tiny / "relight.json"], [of_tiny / "sweep.json"], *tables, 2.0),
)
stage(
    "report",
    lambda module: module.build_report(config(), results, results / "index.html", *tables),
)
print(json.dumps({name: sorted(names) for name, names in loaded.items()}))
"""


def test_the_code_of_a_stage_is_all_that_a_run_of_it_loads(copy: Workflow, tmp_path: Path) -> None:
    report = {"trials": {"symmetric": [1e-2]}, "resolutions": [4, 8]}
    copy.configure(methods={"symmetric": {}}, report=report)  # the settings load no other method
    ended = subprocess.run(
        [sys.executable, "-c", PROGRAM, tmp_path / "matrix", copy.config, copy.path("")],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr
    loaded = {name: set(modules) for name, modules in json.loads(ended.stdout).items()}
    capture = loaded.pop("stages.capture")
    assert len(loaded) == 10
    symmetric = module_of(METHODS, "symmetric")
    for name, modules in loaded.items():
        chosen = [MERGED_WITH if name == "stages.merge" else symmetric]
        shaping = {module for module in modules if not is_shapeless(module)}
        if name in ("report", "stages.evaluating.studies"):  # speak of all methods
            chosen = [module_of(METHODS, method) for method in method_names()]
            # loaded to check the settings of scenes, whose pictures these don't make
            shaping = {module for module in shaping if not module.startswith(KINDS)}
        if name in ("stages.relight", "stages.evaluating.sweep"):
            chosen.append(module_of(SCENES, "wedge"))
        assert shaping <= set(stage_modules(name, *chosen)), name
    assert "rfpipe.stages.capturing.drift" in loaded["stages.merge"]
    assert not loaded["stages.merge"] & {"rfpipe.rigs", "rfpipe.methods.symmetric.method"}
    of_merge = stage_modules("stages.merge", MERGED_WITH)
    assert not [
        name for name in of_merge if name.startswith(("rfpipe.transport", "rfpipe.methods"))
    ]
    assert capture  # has no code that counts


def is_shapeless(module: str) -> bool:
    return any(f"{module}.".startswith(f"{name}.") for name in SHAPELESS)


def test_every_method_counts_for_itself_alone() -> None:
    of_dual = set(stage_modules("stages.refine", module_of(METHODS, "dual")))
    of_symmetric = set(stage_modules("stages.refine", module_of(METHODS, "symmetric")))
    assert "rfpipe.methods.dual" in of_dual - of_symmetric
    assert "rfpipe.methods.symmetric.rank_k" in of_symmetric - of_dual
    for shaping in ("provenance", "patterns", "blocks", "stages.merge", "store.journal"):
        assert f"rfpipe.{shaping}" in of_dual & of_symmetric


@pytest.fixture
def edited(copy: Workflow, tmp_path: Path) -> Workflow:
    """A complete run, and a copy of the package to edit, with the kernels that are compiled."""
    copy.source = tmp_path / "source"
    shutil.copytree(
        Path(rfpipe.__file__).parent,
        copy.source / "rfpipe",
        ignore=shutil.ignore_patterns("*.tmp.*", "*.pyc.*"),  # that another worker writes
    )
    return copy


def edit(workflow: Workflow, *modules: str) -> None:
    assert workflow.source
    for module in modules:
        with (workflow.source / "rfpipe" / module).open("a", encoding="utf-8") as file:
            file.write("\n# edited\n")


def planned(workflow: Workflow) -> set[str]:
    """Acquisitions of `tiny` that would run again."""
    output = workflow.run("--dry-run", "--quiet", "progress", "--", TINY, DUAL)
    return {name for name in (TINY, DUAL) if f"output: {name}" in output}


def test_an_edit_runs_the_acquisitions_again_that_it_may_shape(edited: Workflow) -> None:
    assert planned(edited) == set()  # the copy as it is
    edit(edited, "errors.py", "stages/jobs/progress.py", "rigs/simulated.py", "scenes/radiosity.py")
    edit(edited, "stages/capture.py", "stages/capturing/brackets.py", "methods/near_far/model.py")
    assert planned(edited) == set()  # what takes or names pictures, and other methods
    edit(edited, "methods/dual.py")
    assert planned(edited) == {DUAL}
    edit(edited, "stages/capturing/drift.py")
    assert planned(edited) == {TINY, DUAL}


def test_an_edit_of_the_merge_shows_no_pattern_again(edited: Workflow) -> None:
    edit(edited, "stages/capturing/drift.py")
    made_from = [fingerprints(edited, level) for level in (0, 3)]
    before = edited.contents("tiny/symmetric")
    output = edited.run(TINY)
    assert "all 32 patterns are captured" in output
    assert "patterns in" not in output  # what a capture says that shows any
    after = [fingerprints(edited, level) for level in (0, 3)]
    redone = [
        {stage for stage in old if old[stage] != new[stage]}
        for old, new in zip(made_from, after, strict=True)
    ]
    assert redone[0] == {"merge", "symmetry", "normalize", "refine"}
    assert redone[1] == {"schedule", "merge", "normalize", "refine"}  # of what level 0 refined
    parts = ("/capture", "/reference", "/symmetry.zarr")
    pictures = {name for name in before if any(part in name for part in parts)}
    assert {name: edited.contents("tiny/symmetric")[name] for name in pictures} == {
        name: before[name] for name in pictures
    }
    assert planned(edited) == {DUAL}


def fingerprints(workflow: Workflow, level: int) -> dict[str, str]:
    """What each stage of a level was made from."""
    folder = workflow.path(f"tiny/symmetric/L{level:02d}")
    return {path.stem: read_manifest(path)["fingerprint"] for path in folder.glob("*.json")}
