"""Jobs on a Slurm cluster of two nodes, with both profiles and with a killed node."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.services.slurm import Slurm
from tests.workflow.harness import GLASS, LONG, ROOT, TINY, Workflow, freeze_writer, journal

PROFILES = ROOT / "workflow" / "profiles"
# the settings of the profiles, for a cluster whose jobs take seconds
QUICK = {
    "slurm": ("--slurm-init-seconds-before-status-checks", "2", "--latency-wait", "10"),
    "cluster-generic": ("--seconds-between-status-checks", "2", "--latency-wait", "10"),
}


@pytest.fixture(scope="module")
def daemons(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Slurm]:
    with Slurm(tmp_path_factory.mktemp("slurm") / "cluster") as cluster:
        yield cluster


@pytest.fixture
def slurm(daemons: Slurm, monkeypatch: pytest.MonkeyPatch) -> Slurm:
    """The cluster, configured in the environment of all programs that a test starts."""
    for name in ("SLURM_CONF", "PATH"):
        monkeypatch.setenv(name, daemons.environment[name])
    return daemons


def on(profile: str, *arguments: str) -> tuple[str, ...]:
    """Options that make Snakemake submit its jobs to the cluster."""
    return "--profile", str(PROFILES / profile), *QUICK[profile], *arguments


def test_an_acquisition_continues_after_its_node_is_killed(
    slurm: Slurm, undisturbed: Workflow, tmp_path: Path
) -> None:
    workflow = Workflow(tmp_path / "run")
    workflow.configure(resources={"memory_gib": 0.5})  # fits on a node, also doubled twice
    process = workflow.start(*on("slurm", LONG))
    capture = workflow.path("long/brute_force/L00/capture.zarr")
    freeze_writer(capture, 12)  # so that the job is still running when its node is known
    (node,) = slurm.jobs("RUNNING").values()
    slurm.kill_node(node)
    captured = len(journal(capture))
    assert captured < 40
    time.sleep(1)
    assert len(journal(capture)) == captured  # all of its processes are dead
    slurm.start_node(node)
    output = workflow.end(process)
    assert "Trying to restart job" in output
    log = workflow.path("long/brute_force/acquire.log").read_text()
    assert f"{captured} of 40 patterns are captured; going on at pattern {captured}" in log
    assert workflow.contents("long/brute_force") == undisturbed.contents("long/brute_force")


def test_a_refusal_of_the_scheduler_is_reported(slurm: Slurm, tmp_path: Path) -> None:
    refused = ("--default-resources", "slurm_partition=nope", "--retries", "0")
    output = Workflow(tmp_path / "run").run(*on("slurm", *refused, TINY), succeeds=False)
    assert "Error in rule acquire" in output
    assert "invalid partition specified: nope" in output


def test_the_cause_of_a_dead_job_on_a_generic_cluster_is_reported(
    slurm: Slurm, tmp_path: Path
) -> None:
    workflow = Workflow(tmp_path / "run")
    glass = (ROOT / "tests/examples/frosted_glass.py").read_text()
    ends = "import os\n\n        os.kill(os.getpid(), 9)\n        lit = weights"
    (workflow.folder / "frosted_glass.py").write_text(glass.replace("lit = weights", ends))
    workflow.configure(scenes={"glass": GLASS}, methods={"dual": {}})
    arguments = ("--retries", "0", "results/glass/dual/transport.json")
    output = workflow.run(*on("cluster-generic", *arguments), succeeds=False)
    assert "Error in rule acquire" in output
    (log,) = (workflow.folder / ".snakemake/cluster_logs").glob("acquire-*.log")
    assert "died with <Signals.SIGKILL: 9>" in log.read_text()
    # one processor on any machine, and more memory than any machine has
    resources = next(line for line in output.splitlines() if line.startswith("Provided resources"))
    assert "mem_mb" not in resources


def test_scripts_for_a_generic_cluster_give_the_same_bytes(
    slurm: Slurm, undisturbed: Workflow, tmp_path: Path
) -> None:
    workflow = Workflow(tmp_path / "run")
    workflow.run(*on("cluster-generic", TINY))
    assert workflow.contents("tiny/symmetric") == undisturbed.contents("tiny/symmetric")
