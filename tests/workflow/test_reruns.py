"""Jobs that run again after a change of the settings or the code."""

from __future__ import annotations

import re
import shutil
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tests.workflow.harness import CONFIG, DUAL, Workflow

import rfpipe
from rfpipe.store import read_manifest

LEVELS = 4
SLOW = pytest.mark.slow
ALL = {"schedule", "capture_simulated", "merge", "normalize", "refine", "assemble"}


def jobs(output: str) -> Counter[str]:
    """Number of jobs that ran, by rule."""
    return Counter(re.findall(r"Finished jobid: \d+ \(Rule: (\w+)\)", output))


def pattern_digests(workflow: Workflow) -> list[str]:
    """Digests of each level's patterns."""
    folder = workflow.path("tiny/dual")
    return [
        read_manifest(path).get("pattern_digest", "")
        for path in sorted(folder.glob("L*/schedule.json"))
    ]


def test_a_second_run_has_nothing_to_do(undisturbed: Workflow) -> None:
    ran = jobs((undisturbed.folder / "output").read_text())
    assert set(ran) == ALL
    assert "Nothing to be done" in undisturbed.run(DUAL)


@pytest.mark.parametrize(
    ("changes", "runs"),
    [
        pytest.param({"report": {"title": "another"}}, {}, marks=SLOW),
        pytest.param({"resources": {"memory_gib": 0.5}}, {}, marks=SLOW),
        (
            {"merge": {"mask_defects": False}},
            {"merge": LEVELS, "normalize": LEVELS, "refine": LEVELS, "assemble": 1},
        ),
        pytest.param({"storage": {"number_format": "float32"}}, {"assemble": 1}, marks=SLOW),
        pytest.param(
            {"camera": {"bits": 10}}, {"capture_simulated": LEVELS, "merge": LEVELS}, marks=SLOW
        ),
    ],
    ids=["title", "memory", "merge", "number format", "bit depth"],
)
def test_a_changed_setting_runs_its_stages_again(
    copy: Workflow, changes: dict[str, Any], runs: dict[str, int]
) -> None:
    before = pattern_digests(copy)
    copy.configure(**changes)
    ran = jobs(copy.run(DUAL))
    assert {name: ran[name] for name in runs} == runs
    if "capture_simulated" not in runs:
        captured = sum(old != new for old, new in zip(before, pattern_digests(copy), strict=True))
        assert ran["capture_simulated"] == captured
    if not runs:
        assert not ran
    assert "Nothing to be done" in copy.run(DUAL)


@SLOW
def test_another_tolerance_captures_the_levels_with_other_patterns(copy: Workflow) -> None:
    before = pattern_digests(copy)
    copy.configure(methods={**CONFIG["methods"], "dual": {"tolerance": 0.1}})
    ran = jobs(copy.run(DUAL))
    changed = sum(old != new for old, new in zip(before, pattern_digests(copy), strict=True))
    assert 0 < changed < LEVELS  # otherwise the test proves nothing
    assert ran["capture_simulated"] == changed
    assert ran["refine"] == LEVELS


def comment(source: str) -> str:
    """Add a comment and a docstring."""
    return source.replace('"""Stage:', '# a comment\n"""Another text. Stage:')


def line(source: str) -> str:
    """Change what a stage does."""
    return source.replace('"stage": "refine"', '"stage": "refine", "edited": True')


@pytest.mark.parametrize(
    ("edit", "runs"),
    [pytest.param(comment, set(), marks=SLOW), (line, ALL - {"capture_simulated"})],
    ids=["comment", "line of refine"],
)
def test_edited_code_runs_its_stages_again(
    copy: Workflow, tmp_path: Path, edit: Callable[[str], str], runs: set[str]
) -> None:
    copy.source = tmp_path / "source"
    package = copy.source / "rfpipe"
    shutil.copytree(Path(rfpipe.__file__).parent, package)
    refine = package / "stages" / "refine.py"
    before = refine.read_text()
    refine.write_text(edit(before))
    assert refine.read_text() != before
    assert set(jobs(copy.run(DUAL))) == runs


@SLOW
def test_a_stage_can_be_forced_and_a_run_can_end_at_a_stage(copy: Workflow) -> None:
    before = copy.contents("tiny/dual")
    forced = jobs(copy.run(DUAL, "--forcerun", "merge"))
    assert forced == {
        "merge": LEVELS,
        "normalize": LEVELS,
        "refine": LEVELS,
        "schedule": LEVELS,  # of the next levels, and of the end
    }  # same bytes
    assert copy.contents("tiny/dual") == before
    shutil.rmtree(copy.path("tiny/dual"))
    until = jobs(copy.run(DUAL, "--until", "merge"))
    assert until == {"schedule": 1, "capture_simulated": 1, "merge": 1}


@SLOW
def test_dry_runs_and_graphs_change_no_file(tmp_path: Path) -> None:
    workflow = Workflow(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    planned = workflow.run(DUAL, "--dry-run")
    assert {name for name in ALL if re.search(rf"^{name} +[12]$", planned, re.MULTILINE)} == ALL
    graph = workflow.run(DUAL, "--rulegraph", "dot")
    assert {name for name in ALL if f'label = "{name}"' in graph} == ALL
    remaining = {path for path in tmp_path.rglob("*") if ".snakemake" not in path.parts}
    assert sorted(remaining) == before


@SLOW
def test_one_job_per_acquisition_continues_from_single_stages(
    copy: Workflow, undisturbed: Workflow
) -> None:
    copy.configure(resources={"jobs": "acquisition"})
    folder = copy.path("tiny/dual")
    (folder / "transport.json").unlink()
    for name in ("L02", "L03"):
        shutil.rmtree(folder / name)
    assert jobs(copy.run(DUAL)) == {"acquire": 1}
    assert copy.contents("tiny/dual") == undisturbed.contents("tiny/dual")
    # Snakemake has no settings of the jobs that this job replaced
    copy.configure(merge={"mask_defects": False})
    assert jobs(copy.run(DUAL))["merge"] == LEVELS
    assert "Nothing to be done" in copy.run(DUAL)
    copy.configure()
    for path in [folder / "transport.json", *folder.glob("L03/*.json")]:
        path.unlink()
    assert set(jobs(copy.run(DUAL))) == ALL
    assert copy.contents("tiny/dual") == undisturbed.contents("tiny/dual")
