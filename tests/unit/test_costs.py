"""What jobs take: laws that are fitted, records that jobs leave, and what rules ask for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rfpipe.config import Config
from rfpipe.costs import JobCosts, Record, fit_laws, read_shipped, records_in, write_records
from rfpipe.costs.model import fit_law
from rfpipe.stages.jobs.job import USAGE
from rfpipe.store import write_manifest

FACTS = {
    "scene": "mine", "method": "rough", "acquired_by": "dual", "camera_shape": [6, 8],
    "projector_shape": [2, 6, 8], "channels": 3, "patterns": 40,
}  # fmt: skip


def left_by_jobs(results: Path, seconds: float, stage_seconds: float) -> Path:
    folder = results / "mine" / "rough"
    (folder / "L00").mkdir(parents=True)
    write_manifest(folder / "transport.json", FACTS)
    usage = USAGE % (250.0, 4.5)
    (folder / "acquire.log").write_text(f"2026-11-23 INFO begun\n2026-11-23 INFO {usage}\n")
    (folder / "acquire.benchmark.tsv").write_text(f"s\tmax_rss\n{seconds}\t70.0\n")
    (folder / "L00" / "merge.benchmark.tsv").write_text(f"s\n{stage_seconds}\n")
    return folder


def test_a_job_is_known_by_what_its_log_says_at_its_end(tmp_path: Path) -> None:
    left_by_jobs(tmp_path, 9.0, 8.0)
    (record,) = records_in(tmp_path)
    assert record == Record("acquire", "mine", "rough", "dual", 48, 96, 2, 3, 40, 4.5, 9.0, 250.0)
    assert record.samples == 144
    write_records([record], tmp_path / "table.csv")
    assert "250" in (tmp_path / "table.csv").read_text()


def test_a_job_that_went_on_or_failed_says_nothing(tmp_path: Path) -> None:
    folder = left_by_jobs(tmp_path, 9.0, 20.0)
    assert records_in(tmp_path) == []
    (folder / "L00" / "merge.benchmark.tsv").unlink()
    assert len(records_in(tmp_path)) == 1
    (folder / "acquire.log").write_text("killed in the middle")
    assert records_in(tmp_path) == []


@pytest.mark.parametrize("power", [0.5, 1.0, 1.5])
def test_a_law_is_found_again(power: float) -> None:
    samples = np.geomspace(200, 100_000, 8)
    law = fit_law(samples, 90 + 0.02 * samples**power)
    assert law.power == power
    assert law(1e6) == pytest.approx(90 + 0.02 * 1e6**power, rel=1e-6)


def record(samples: int, memory: float, **changes: object) -> Record:
    base = Record("acquire", "a", "dual", "dual", samples, samples, 1, 1, 10, 5.0, 9.0, memory)
    return replace(base, **changes)  # type: ignore[arg-type]


def test_jobs_nearby_correct_the_law_and_far_ones_do_not() -> None:
    table = [record(size, 100 + size / 10) for size in (100, 1000, 10_000, 100_000)]
    alone = fit_laws(table).predict("memory_mb", "acquire", "dual", 10_000)
    assert alone == pytest.approx(1100)
    nearby = [record(12_000, 2 * 1300.0), record(100, 9999.0), record(10_000, 1.0, job="view")]
    predicted = fit_laws(table, nearby).predict("memory_mb", "acquire", "dual", 10_000)
    assert predicted == pytest.approx(2 * 1100)


def test_what_is_not_in_the_table_is_taken_for_the_dearest() -> None:
    table = [record(size, size, method=name) for size in (100, 1000) for name in ("dual", "other")]
    table += [record(size, 5 * size, method="dear") for size in (100, 1000)]
    laws = fit_laws(table)
    assert laws.predict("memory_mb", "acquire", "my_own", 500) == pytest.approx(2500)
    assert laws.predict("memory_mb", "acquire", "dual", 500, views=4) == pytest.approx(500)
    assert laws.predict("memory_mb", "studies", "dual", 500) is None


def settings(**changes: object) -> Config:
    scene = {"kind": "wedge", "surfaces": ["white", "white"], "shape": [40, 48]}
    made = {"scenes": {"a": scene}, "methods": {"dual": {}}, **changes}
    return Config.model_validate(made)


def test_each_attempt_asks_for_more(tmp_path: Path) -> None:
    costs = JobCosts(settings(), tmp_path)
    predicted = costs.predict("memory_mb", "acquire", "a", "dual")
    assert predicted is not None
    asked = [costs.memory_mb("acquire", "a", "dual", attempt) for attempt in (1, 2, 3)]
    assert predicted < asked[0] < asked[1] < asked[2]
    minutes = [costs.runtime("acquire", "a", "dual", attempt) for attempt in (1, 2)]
    assert minutes[1] == 2 * minutes[0] >= 20
    # brackets of 5,760 samples, 16 bits and four exposures, for some hundreds of patterns
    assert 10 < costs.disk_mb("a", "dual") < 1000
    assert costs.memory_mb("studies", "a", "dual") == 4295  # resources.memory_gib


def test_a_job_with_the_rig_asks_for_the_rigs_time(tmp_path: Path) -> None:
    scenes = {"a": {"kind": "captured", "shape": [40, 48]}}
    quick, slow = (
        JobCosts(settings(scenes=scenes, capture=capture), tmp_path)
        for capture in ({"rig": "remote", "seconds_per_pattern": each} for each in (0.1, 20.0))
    )
    assert slow.runtime("acquire", "a", "dual") > 10 * quick.runtime("acquire", "a", "dual")
    assert slow.runtime("view", "a", "dual") == quick.runtime("view", "a", "dual")


def test_memory_of_the_shipped_jobs_is_told_from_jobs_of_other_sizes() -> None:
    shipped = read_shipped()
    assert {one.job for one in shipped} >= {"acquire", "relight", "verification"}
    ratios = []
    for size in {one.samples for one in shipped}:
        laws = fit_laws([one for one in shipped if one.samples != size])
        for one in shipped:
            if one.samples == size:
                told = laws.predict("memory_mb", one.job, one.method, size, views=one.views)
                if told is not None:
                    ratios.append(told / one.memory_mb)
    within = np.mean(np.abs(np.array(ratios) - 1) <= 0.3)
    assert within >= 0.7
