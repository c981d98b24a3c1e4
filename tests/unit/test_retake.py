"""Retakes: levels by their names, and the results that are set aside or removed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.rigs.known_matrix import run

from rfpipe.config import Config
from rfpipe.errors import CaptureError, InputError
from rfpipe.photometry import CameraModel
from rfpipe.rigs import OperatorRig
from rfpipe.stages import rig_sources
from rfpipe.storage.base import STAGES, rig_settings
from rfpipe.storage.retake import find_retakes
from rfpipe.store import write_manifest

LEVELS = ("L00", "L01", "L02", "verification")
STORES = {"L00": ("capture", "reference_brackets", "check_pictures"), "verification": ("capture",)}


@pytest.fixture
def results(tmp_path: Path) -> Path:
    """Results of two finished acquisitions of three levels, with verification."""
    for method in ("dual", "auto"):
        folder = tmp_path / "results" / "vase" / method
        for level in LEVELS:
            for stage in STAGES[: 3 if level == "verification" else 5]:
                write_manifest(folder / level / f"{stage}.json", {"patterns": 4})
            for store in STORES.get(level, ("capture",)):
                (folder / level / f"{store}.zarr").mkdir()
                (folder / level / f"{store}.zarr" / "c.0").write_text("light")
        for name in ("transport", "verification"):
            write_manifest(folder / f"{name}.json", {"digest": "x"})
    return tmp_path / "results"


def present(results: Path) -> set[str]:
    return {
        str(path.relative_to(results)) for path in results.rglob("*") if ".lock" not in path.name
    }


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("vase/dual/L02", ["L02"]),
        ("vase/dual/2", ["L02"]),
        ("vase/dual/l2/", ["L02"]),
        ("vase/dual/verification", ["verification"]),
        ("vase/dual", ["L00", "L01", "L02", "verification"]),
    ],
)
def test_names_of_levels(results: Path, name: str, expected: list[str]) -> None:
    retakes = find_retakes(results, [name, name])
    assert [retake.path for retake in retakes] == [results / "vase/dual" / it for it in expected]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("vase/daul/2", r"vase/daul/2: nothing is captured by this name.*such as vase/dual/L02"),
        ("vase/dual/7", "such as vase/dual/L0"),
        ("vase", "such as vase/"),
        ("jug/dual", "such as vase/dual"),
        ("../vase/dual", "nothing is captured by this name"),
    ],
)
def test_an_unknown_name_is_answered_with_similar_ones(
    results: Path, name: str, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        find_retakes(results, [name])
    with pytest.raises(InputError, match="nothing is captured in"):
        find_retakes(results / "elsewhere", [name])


def test_acquisitions_that_are_not_in_the_settings_persist(results: Path) -> None:
    with pytest.raises(InputError, match="the settings have no acquisition of vase by auto"):
        find_retakes(results, ["vase/auto"], [("vase", "dual")])


@pytest.mark.parametrize(
    ("level", "removed_names", "present_names"),
    [
        (
            "L01",
            {"L01/capture", "L01/merge", "L01/refine", "L02/refine", "transport"},
            {"L00/refine", "L01/schedule", "L02/capture", "L02/normalize", "verification/capture"},
        ),
        (
            "L00",
            {"L00/capture", "L01/merge", "L02/merge", "L02/refine", "transport"},
            {"L00/schedule", "L01/capture", "L02/capture", "L02/schedule"},
        ),
        (
            "verification",
            {"verification/capture", "verification/merge", "verification"},
            {"L00/capture", "L02/refine", "transport"},
        ),
    ],
)
def test_manifests_of_later_results_are_removed_and_all_pictures_stay(
    results: Path, level: str, removed_names: set[str], present_names: set[str]
) -> None:
    before = present(results)
    (retake,) = find_retakes(results, [f"vase/dual/{level}"])
    aside = retake.set_aside()
    after = present(results)
    manifests = {path.removesuffix(".json") for path in after if path.endswith(".json")}
    assert not {f"vase/dual/{name}" for name in removed_names} & manifests
    assert {f"vase/dual/{name}" for name in present_names} <= manifests
    assert {path.name for path in aside} == {
        f"{store}.before_1.zarr" for store in STORES.get(level, ("capture",))
    }
    assert sum(path.endswith("c.0") for path in after) == sum(p.endswith("c.0") for p in before)
    assert {p for p in after if "/auto/" in p} == {p for p in before if "/auto/" in p}


def test_pictures_that_are_set_aside_twice_are_both_kept(results: Path) -> None:
    (retake,) = find_retakes(results, ["vase/dual/1"])
    retake.set_aside()
    store = results / "vase/dual/L01/capture.zarr"
    store.mkdir()
    assert [path.name for path in retake.set_aside()] == ["capture.before_2.zarr"]


def test_merged_images_are_set_aside_if_raw_exposures_were_dropped(results: Path) -> None:
    level = results / "vase/dual/L02"
    write_manifest(level / "capture.zarr/dropped.json", {})
    for name in ("merge", "sums"):
        (level / f"{name}.zarr").mkdir()
    (retake,) = find_retakes(results, ["vase/dual/2"])
    assert {path.name for path in retake.set_aside()} == {
        f"{name}.before_1.zarr" for name in ("capture", "merge", "sums")
    }


def test_retakes_of_offline_rigs_refer_to_withdrawing_pictures(
    results: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(results.parent)
    Path("desk.yaml").write_text(
        "scenes: {vase: {kind: captured, shape: [8, 8]}}\n"
        "methods: {dual: {}}\n"
        "capture: {rig: offline}\n"
    )
    before = present(results)
    with pytest.raises(InputError, match="rfpipe import FOLDER --take-back"):
        run("run", "--configfile", "desk.yaml", "--retake", "vase/dual")
    assert present(results) == before


def test_a_dry_run_changes_no_file(results: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(results.parent)
    before = present(results)
    output = run("run", "--dry-run", "--retake", "vase/dual/2")
    assert "results/vase/dual/L02: its pictures would be captured again" in output
    assert present(results) == before


def test_earlier_pictures_are_restored_and_later_ones_set_aside(results: Path) -> None:
    before = present(results)
    store = results / "vase/dual/L00/capture.zarr"
    (retake,) = find_retakes(results, ["vase/dual/0"])
    retake.set_aside()
    # a run that failed before it took a picture
    (retake,) = find_retakes(results, ["vase/dual/0"], option="--put-back")
    assert {path.name for path in retake.put_back()} == {f"{it}.zarr" for it in STORES["L00"]}
    assert {path for path in before if ".zarr" in path} <= present(results)
    retake.set_aside()
    store.mkdir()
    (store / "c.0").write_text("new light")
    write_manifest(store.with_name("capture.json"), {})
    write_manifest(results / "vase/dual/transport.json", {})
    retake.put_back()
    assert (store / "c.0").read_text() == "light"
    assert (store.with_name("capture.before_2.zarr") / "c.0").read_text() == "new light"
    removed_names = (store.with_name("capture.json"), results / "vase/dual/transport.json")
    assert not any(path.exists() for path in removed_names)
    (retake,) = find_retakes(results, ["vase/dual/1"])
    with pytest.raises(InputError, match="no pictures are set aside in"):
        retake.put_back()


CAMERAS = {"as before": {}, "other": {"exposures": (0.5,)}}


@pytest.mark.parametrize(
    ("server", "name", "message"),
    [
        ("down", "vase/dual", "no answer"),
        ("down", "vase/dual/L02", "no answer"),
        ("other rays", "vase/dual", "the rig has"),
        ("other", "vase/dual/L02", "the rig is not that of the patterns captured before"),
        ("other", "vase/dual/L00", "the rig is not that of the patterns captured before"),
        ("other", "vase/dual", None),
        ("as before", "vase/dual/L02", None),
    ],
)
def test_pictures_are_set_aside_only_if_the_same_rig_answers(
    results: Path, monkeypatch: pytest.MonkeyPatch, server: str, name: str, message: str | None
) -> None:
    def rig_of_server(url: str, token: str, patience: float) -> OperatorRig:
        assert patience <= 10
        if server == "down":
            raise CaptureError(f"{url}: no answer")
        side = 6 if server == "other rays" else 4
        camera = CameraModel(**CAMERAS.get(server, {}))
        rig = OperatorRig(np.eye(side * side)[None], (side, side), (side, side), camera)
        rig.url, rig.close = url, lambda: None
        return rig

    monkeypatch.setattr(rig_sources, "RemoteRig", rig_of_server)
    monkeypatch.setenv("RFPIPE_TOKEN", "a-token-for-tests-only")
    monkeypatch.chdir(results.parent)
    monkeypatch.setattr(rig_sources, "_recorded_rig", lambda folder: described)
    settings = Config.model_validate(
        {
            "scenes": {"vase": {"kind": "captured", "shape": [4, 4], "channels": 1}},
            "methods": {"dual": {}},
            "capture": {"rig": "remote", "url": "http://127.0.0.1:1"},
        }
    )
    described = rig_settings(OperatorRig(np.eye(16)[None], (4, 4), (4, 4), CameraModel()))
    retakes = find_retakes(results, [name])
    if message is None:
        rig_sources.check_retakes(settings, retakes)
    else:
        with pytest.raises(CaptureError, match=f"{message}.*set nothing aside"):
            rig_sources.check_retakes(settings, retakes)
