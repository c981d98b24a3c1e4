"""Jobs on a real Slurm daemon of two nodes, by both profiles, with a node killed meanwhile."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.slurm import Slurm, need_slurm
from tests.workflow.harness import LONG, ROOT, TINY, Workflow, journal, wait_until

PROFILES = ROOT / "workflow" / "profiles"
# as the profiles, but for a cluster whose jobs take seconds
QUICK = {
    "slurm": ("--slurm-init-seconds-before-status-checks", "2", "--latency-wait", "10"),
    "cluster-generic": ("--seconds-between-status-checks", "2", "--latency-wait", "10"),
}


@pytest.fixture(scope="module")
def slurm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Slurm]:
    need_slurm()
    with Slurm(tmp_path_factory.mktemp("slurm") / "cluster") as cluster:
        yield cluster


def on(slurm: Slurm, profile: str, *arguments: str) -> tuple[str, ...]:
    """Options of Snakemake by which jobs go to the cluster, in its environment."""
    os.environ["SLURM_CONF"] = slurm.environment["SLURM_CONF"]
    return "--profile", str(PROFILES / profile), *QUICK[profile], *arguments


@pytest.fixture(autouse=True)
def _environment_as_before(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SLURM_CONF", "")


def test_a_node_killed_in_the_middle_of_an_acquisition(
    slurm: Slurm, undisturbed: Workflow, tmp_path: Path
) -> None:
    workflow = Workflow(tmp_path / "run")
    process = workflow.start(*on(slurm, "slurm", LONG))
    capture = workflow.path("long/brute_force/L00/capture.zarr")
    wait_until(lambda: len(journal(capture)) > 20, "20 patterns")
    (node,) = slurm.jobs("RUNNING").values()
    slurm.kill_node(node)
    taken = len(journal(capture))
    assert taken < 288
    time.sleep(1)
    assert len(journal(capture)) == taken  # nothing of it lives
    slurm.start_node(node)
    said = workflow.end(process)
    assert "NODE_FAIL" in said
    assert f"{taken} of 288 patterns are captured; going on" in said
    assert workflow.contents("long/brute_force") == undisturbed.contents("long/brute_force")


def test_scripts_of_ones_own_cluster(slurm: Slurm, undisturbed: Workflow, tmp_path: Path) -> None:
    workflow = Workflow(tmp_path / "run")
    workflow.run(*on(slurm, "cluster-generic", TINY))
    assert workflow.contents("tiny/symmetric") == undisturbed.contents("tiny/symmetric")
