"""What jobs take: laws that are fitted, and records that jobs leave."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rfpipe.config import SceneSettings
from rfpipe.costs import (
    Record,
    Subject,
    fit_laws,
    read_shipped,
    records_in,
    write_records,
)
from rfpipe.costs.model import fit_law
from rfpipe.scenes import scene_from_config
from rfpipe.scenes.kinds.surfaces import WedgeOptions
from rfpipe.stages.jobs import workers
from rfpipe.stages.jobs.job import USAGE
from rfpipe.store import write_manifest

FACTS = {
    "scene": "mine", "method": "rough", "acquired_by": "dual", "camera_shape": [6, 8],
    "projector_shape": [2, 6, 8], "channels": 3, "patterns": 40,
}  # fmt: skip


SCENES = {"mine": SceneSettings.of("captured")}


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
    (record,) = records_in(tmp_path, SCENES)
    assert record == Record(
        "acquire", "mine", "rough", "dual", 48, 96, 2, 3, 40, 0.0, 4.5, 9.0, 250.0
    )
    assert record.subject == Subject("dual", 48, 2, 0.0)
    write_records([record], tmp_path / "table.csv")
    assert "250" in (tmp_path / "table.csv").read_text()


def test_a_job_that_went_on_or_failed_says_nothing(tmp_path: Path) -> None:
    folder = left_by_jobs(tmp_path, 9.0, 20.0)
    assert records_in(tmp_path, SCENES) == []
    (folder / "L00" / "merge.benchmark.tsv").unlink()
    assert len(records_in(tmp_path, SCENES)) == 1
    (folder / "acquire.log").write_text("killed in the middle")
    assert records_in(tmp_path, SCENES) == []


@pytest.mark.parametrize("power", [0.5, 1.0, 1.5])
def test_a_law_is_found_again(power: float) -> None:
    samples = np.geomspace(200, 100_000, 8)
    law = fit_law(samples, 90 + 0.02 * samples**power)
    assert law.power == power
    assert law(1e6) == pytest.approx(90 + 0.02 * 1e6**power, rel=1e-6)


def record(samples: int, memory: float, **changes: object) -> Record:
    base = Record("acquire", "a", "dual", "dual", samples, samples, 1, 3, 10, 0.0, 5.0, 9.0, memory)
    return replace(base, **changes)  # type: ignore[arg-type]


def subject(size: float, method: str = "dual", views: int = 1, simulation: float = 0) -> Subject:
    return Subject(method, size, views, simulation)


def test_jobs_nearby_correct_the_law_and_far_ones_do_not() -> None:
    table = [record(size, 100 + size / 10) for size in (100, 1000, 10_000, 100_000)]
    alone = fit_laws(table).predict("memory_mb", "acquire", subject(10_000))
    assert alone == pytest.approx(1100)
    nearby = [record(12_000, 2 * 1300.0), record(100, 9999.0), record(10_000, 1.0, job="view")]
    predicted = fit_laws(table, nearby).predict("memory_mb", "acquire", subject(10_000))
    assert predicted == pytest.approx(2 * 1100)


def test_what_a_scene_takes_is_told_beside_the_law() -> None:
    net = {1000: 200, 2000: 300, 4000: 500, 8000: 900}
    scene = {1000: 10, 2000: 40, 4000: 160, 8000: 0}
    table = [record(size, net[size] + scene[size], simulation_mb=scene[size]) for size in net]
    laws = fit_laws(table)
    assert laws.predict("memory_mb", "acquire", subject(6000)) == pytest.approx(700)
    assert laws.predict("memory_mb", "acquire", subject(6000, simulation=360)) == pytest.approx(
        1060
    )
    views = [replace(one, job="view", memory_mb=net[one.camera_rays]) for one in table]
    told = fit_laws(views).predict("memory_mb", "view", subject(6000, simulation=360))
    assert told == pytest.approx(700)  # it has a transport before it, no scene


def test_form_factors_are_counted_where_they_are_stored_densely() -> None:
    both = {"kind": "wedge", "surfaces": ["white", "texture"], "shape": [24, 28]}
    scene = SceneSettings.model_validate(both)
    assert isinstance(scene, WedgeOptions)
    simulated: Any = scene_from_config(scene)
    assert scene.simulation_bytes == simulated._surfaces.form_factors.nbytes > 0
    large = SceneSettings.model_validate({**both, "shape": [310, 350]})
    assert large.simulation_bytes == 0  # compressed
    direct = SceneSettings.model_validate({**both, "bounces": 1})
    assert direct.simulation_bytes == 0


def test_what_is_not_in_the_table_is_taken_for_the_dearest() -> None:
    table = [record(size, size, method=name) for size in (100, 1000) for name in ("dual", "other")]
    table += [record(size, 5 * size, method="dear") for size in (100, 1000)]
    table += [record(size, 50 * size, method="of few rays") for size in (5, 10)]
    laws = fit_laws(table)
    assert laws.predict("memory_mb", "acquire", subject(500, "my_own")) == pytest.approx(2500)
    assert laws.predict("memory_mb", "acquire", subject(10**6, "my_own")) == pytest.approx(5e6)
    assert laws.predict("memory_mb", "acquire", subject(500, views=4)) == pytest.approx(500)
    assert laws.predict("memory_mb", "studies", subject(500)) is None


def test_memory_of_the_shipped_jobs_is_told_from_jobs_of_other_sizes() -> None:
    shipped = read_shipped()
    assert {one.job for one in shipped} >= {"acquire", "relight", "verification"}
    ratios = []
    for size in {one.subject.size for one in shipped}:
        laws = fit_laws([one for one in shipped if one.subject.size != size])
        for one in shipped:
            if one.subject.size == size:
                told = laws.predict("memory_mb", one.job, one.subject)
                if told is not None:
                    ratios.append(told / one.memory_mb)
    within = np.mean(np.abs(np.array(ratios) - 1) <= 0.3)
    assert within >= 0.9


def test_the_machines_memory_is_what_its_group_leaves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    limit = tmp_path / "memory.max"
    monkeypatch.setattr(workers, "_GROUP_LIMIT", limit)
    whole = workers.machine_memory_mb()
    assert whole > 100
    limit.write_text("max\n")
    assert workers.machine_memory_mb() == whole
    limit.write_text("64000000\n")
    assert workers.machine_memory_mb() == 64
