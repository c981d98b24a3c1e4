"""Complete runs: their manifests and reports, and mistakes in their settings."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import pytest
from tests.workflow.harness import CONFIG, STAGES, Workflow

from rfpipe import open_transport
from rfpipe.storage.base import scheduled_levels
from rfpipe.storage.files import FolderStorage


def test_every_stage_of_every_level_has_a_manifest(undisturbed: Workflow) -> None:
    for method in ("symmetric", "dual"):
        folder = FolderStorage(undisturbed.path(f"tiny/{method}"))
        levels = list(scheduled_levels(folder))
        # the last schedule has no patterns: the acquisition is complete
        assert len(levels) + 1 == len(list(folder.path.glob("L*"))) > 3
        for level, stage in product(levels, STAGES):
            stated = {"stage", "level", "units"}
            stated |= {"pattern_digest"} if stage == "schedule" else {"digest", "fingerprint"}
            assert stated <= set(folder.read_manifest(level, stage))
            for suffix in (".log", ".benchmark.tsv"):
                assert folder.manifest(level, stage).with_suffix(suffix).exists()
        assert open_transport(undisturbed.path(f"tiny/{method}/transport.zarr")).channels == 3


@pytest.mark.slow
def test_a_run_ends_with_a_report_and_a_second_one_has_nothing_to_do(copy: Workflow) -> None:
    scenes = {**ONE_SCENE, "field": LIGHT_FIELD}
    copy.configure(scenes=scenes, methods={"symmetric": {}, "dual": {}})
    copy.run()  # continues from the existing acquisitions
    page = copy.path("report/index.html").read_text(encoding="utf-8")
    assert "<html" in page
    assert 'src="http' not in page
    assert len(copy.path("report/tables/errors.csv").read_text().splitlines()) == 1 + 2 * 8 + 9
    assert open_transport(copy.path("field/symmetric/transport.zarr")).camera_shape == (4, 8, 12)
    assert not copy.path("field/dual").exists()
    assert "Nothing to be done" in copy.run()


ONE_SCENE = {"tiny": CONFIG["scenes"]["tiny"]}
LIGHT_FIELD = {
    "kind": "room",
    "surfaces": ["texture", "white", "white"],
    "shape": [8, 12],
    "views": [2, 2],
    "methods": {"symmetric": {}},
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ("methods: {dual: {tolerence: 1e-3}}", "dual.tolerence is unknown; did you mean"),
        ("seed: 1\nseed: 2", "the key 'seed' appears twice"),
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
