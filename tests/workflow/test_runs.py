"""Whole runs: what they leave, what changed settings make again, and damaged stores."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from tests.workflow.harness import CONFIG, DUAL, LONG, STAGES, TINY, Workflow, journal, undo

from rfpipe import acquire, open_transport
from rfpipe.config import Config, load_config
from rfpipe.photometry import sensor_from_config
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes import scene_from_config
from rfpipe.store import read_manifest


def test_every_stage_of_every_level_leaves_a_manifest(undisturbed: Workflow) -> None:
    for method in ("symmetric", "dual"):
        for level in range(4):
            for stage in STAGES:
                manifest = read_manifest(
                    undisturbed.path(f"tiny/{method}/L{level:02d}/{stage}.json")
                )
                assert {"digest", "fingerprint", "stage", "level", "units"} <= set(manifest)
                log = undisturbed.path(f"tiny/{method}/L{level:02d}/{stage}.benchmark.tsv")
                assert log.exists()
        assert open_transport(undisturbed.path(f"tiny/{method}/transport.zarr")).channels == 3


@pytest.mark.parametrize(
    ("scene", "method"), [("tiny", "symmetric"), ("tiny", "dual"), ("long", "brute_force")]
)
def test_the_files_hold_what_an_acquisition_in_process_finds(
    undisturbed: Workflow, scene: str, method: str
) -> None:
    config = load_config(undisturbed.config)
    rig = SimulatedRig(
        scene_from_config(config.scenes[scene]), sensor_from_config(config.camera), config.seed
    )
    result = acquire(
        rig,
        method,
        progress=False,
        black_frames=config.capture.black_frames,
        floodlit_frames=config.capture.floodlit_frames,
    )
    stored = open_transport(undisturbed.path(f"{scene}/{method}/transport.zarr"))
    expected, attributes = result.transport.pack(config.storage.number_format)
    found, stored_attributes = stored.pack(config.storage.number_format)
    assert stored_attributes == attributes
    assert set(found) == set(expected)
    for name, array in expected.items():
        np.testing.assert_array_equal(found[name], array, err_msg=name)


def test_the_whole_run_ends_in_a_report_and_then_has_nothing_to_do(copy: Workflow) -> None:
    scenes = {**ONE_SCENE, "field": LIGHT_FIELD}
    copy.configure(scenes=scenes, methods={"symmetric": {}, "dual": {}}, report=SMALL_REPORT)
    copy.run()  # goes on from the acquisitions that stand there
    page = copy.path("report/index.html").read_text(encoding="utf-8")
    assert "<html" in page
    assert 'src="http' not in page
    assert len(copy.path("report/tables/errors.csv").read_text().splitlines()) == 1 + 2 * 6 + 6
    assert open_transport(copy.path("field/symmetric/transport.zarr")).camera_shape == (4, 8, 12)
    assert not copy.path("field/dual").exists()
    assert not copy.path("field/symmetric/sweep.json").exists()
    assert "Fig. 5.8" in page
    assert "Nothing to be done" in copy.run()


ONE_SCENE = {"tiny": CONFIG["scenes"]["tiny"]}
LIGHT_FIELD = {
    "kind": "room",
    "surfaces": ["texture", "white", "white"],
    "shape": [8, 12],
    "views": [2, 2],
    "methods": {"symmetric": {}},
    "sweep": False,
}
SMALL_REPORT = {"trials": {"symmetric": [1e-2], "dual": [1e-2]}, "resolutions": [4, 8]}


def with_tolerance(tolerance: float) -> dict[str, Any]:
    """Return the methods with another tolerance of symmetric photography."""
    return {**CONFIG["methods"], "symmetric": {"tolerance": tolerance}}


def test_a_looser_tolerance_captures_only_changed_patterns_anew(copy: Workflow) -> None:
    folder = copy.path("tiny/symmetric")
    before = copy.contents("tiny/symmetric")
    shown = {level: patterns_shown(folder, level) for level in range(4)}
    captured = {level: (folder / f"L{level:02d}/capture.zarr").stat().st_ino for level in range(4)}

    copy.configure(methods=with_tolerance(0.05))
    output = copy.run(TINY)
    for level in range(4):
        changed = patterns_shown(folder, level) != shown[level]
        again = (folder / f"L{level:02d}/capture.zarr").stat().st_ino != captured[level]
        assert again == changed
        said = re.search(rf"L{level:02d}/capture: .*CAPTURING ANEW.*patterns ", output)
        assert bool(said) == changed
    assert patterns_shown(folder, 0) == shown[0]
    assert patterns_shown(folder, 3) != shown[3]  # or the test shows nothing

    copy.configure(methods=with_tolerance(1e-3))
    output = copy.run(TINY)  # the old pictures are found again: no pattern is shown
    assert "patterns in" not in output
    assert "captured with these settings before" in output
    after = copy.contents("tiny/symmetric")
    assert {name: after[name] for name in before} == before


def patterns_shown(folder: Path, level: int) -> tuple[int, str]:
    manifest = read_manifest(folder / f"L{level:02d}/schedule.json")
    return manifest["patterns"], manifest["shown"]


def test_the_default_run_with_every_thesis_method_has_few_jobs(tmp_path: Path) -> None:
    workflow = Workflow(tmp_path)
    methods = {"symmetric": {}, "dual": {}, "near_far": {}}
    workflow.config.write_text(yaml.safe_dump({"methods": methods}))
    output = workflow.run("--dry-run")
    jobs = dict(re.findall(r"^(\w+) +(\d+)$", output, re.MULTILINE))
    assert int(jobs["acquire_simulated"]) == len(Config().acquisitions) == 13
    assert int(jobs["total"]) <= 60


def test_other_resources_run_nothing_again(copy: Workflow) -> None:
    copy.configure(resources={"memory_gib": 0.5})
    assert "Nothing to be done" in copy.run(TINY, DUAL, LONG)


def test_changed_patterns_can_be_refused(copy: Workflow) -> None:
    copy.configure(methods=with_tolerance(0.05), capture={"when_patterns_change": "refuse"})
    kept = journal(copy.path("tiny/symmetric/L03/capture.zarr"))
    output = copy.run(TINY, succeeds=False)
    assert re.search(r"holds \d+ captured patterns of other settings \(patterns \d+ -> \d+", output)
    assert "capture.when_patterns_change" in output
    assert journal(copy.path("tiny/symmetric/L03/capture.zarr")) == kept


def test_merge_options_show_no_pattern_again(copy: Workflow) -> None:
    copy.configure(merge={"mask_defects": False})
    before = copy.path("tiny/symmetric/L03/merge.json").read_bytes()
    output = copy.run(TINY)
    assert "patterns are captured" in output
    assert "patterns in" not in output  # what a capture says that shows any
    assert copy.path("tiny/symmetric/L03/merge.json").read_bytes() != before


@pytest.mark.parametrize("harm", ["alter", "truncate", "remove"])
def test_a_damaged_chunk_is_found_by_the_next_stage_and_can_be_made_again(
    copy: Workflow, undisturbed: Workflow, harm: str
) -> None:
    level = copy.path("tiny/symmetric/L03")
    undo(copy, 3, "merge")
    chunk = level / "capture.zarr" / "c.1.0.0.0.0"
    content = bytearray(chunk.read_bytes())
    if harm == "remove":
        chunk.unlink()
    elif harm == "truncate":
        chunk.write_bytes(content[: len(content) // 2])
    else:
        content[len(content) // 2] ^= 255
        chunk.write_bytes(content)

    output = copy.run(TINY, succeeds=False)
    assert f"{chunk.relative_to(copy.folder)}: item 1 is missing, truncated or altered" in output
    manifest = level / "capture.json"
    assert f"remove {manifest.relative_to(copy.folder)} and run again" in output
    manifest.unlink()
    output = copy.run(TINY)
    assert "1 items are damaged and will be written again (1)" in output
    assert "level 3: 1 patterns in" in output
    assert copy.contents("tiny/symmetric") == undisturbed.contents("tiny/symmetric")


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ("methods: {dual: {tolerence: 1e-3}}", "dual.tolerence is unknown; did you mean"),
        ("methods: {dual: {tolerance: 2}}", "methods.dual.tolerance is 2"),
        ("acquisition: {tolerance: 1e-3}", "methods: {symmetric: {tolerance: 1.0e-3}"),
        ("seed: 1\nseed: 2", "the key 'seed' stands twice"),
    ],
)
def test_a_mistake_in_the_settings_ends_the_run_before_it_begins(
    tmp_path: Path, settings: str, message: str
) -> None:
    workflow = Workflow(tmp_path)
    workflow.config.write_text(settings)
    output = workflow.run("--dry-run", succeeds=False)
    assert message in output
    assert not (tmp_path / "results").exists()
