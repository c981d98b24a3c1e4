"""A complete calibration of simulated devices: its steps, folder, report and command."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.rigs.calibration_bench import CAMERA, GAMMA, Bench, brighter, wedge_bench

from rfpipe.calibration import latency
from rfpipe.calibration.folder import CalibrationFolder
from rfpipe.calibration.run import calibrate, calibrate_rig, finish
from rfpipe.calibration.steps import STEPS
from rfpipe.config import CalibrationConfig, RigConfig, parse_rig_config
from rfpipe.errors import CaptureError, ConfigError, InputError, IntegrityError, StoreError
from rfpipe.report.calibration import _steadiness, build_calibration_report
from rfpipe.rigs.calibrated import load_calibration as load
from rfpipe.rigs.faults import CALIBRATION
from rfpipe.store import write_arrays

pytestmark = pytest.mark.usefixtures("quick_fonts")

RAYS = (16, 16)
SETTINGS = CalibrationConfig(dark_frames=4, levels=6, codes=17, symmetry_patterns=6, tolerance=0.03)


def begun(
    folder: Path, rays: tuple[int, int] = RAYS, *more: Any, **changes: Any
) -> tuple[Bench, CalibrationFolder, Callable[..., None]]:
    """Return a bench, the folder of its calibration, and a function that runs it."""
    bench, place = wedge_bench(rays, *more, **changes), CalibrationFolder(folder / "calibration")

    def run(only: list[str] | None = None, bench: Bench = bench, **changed: Any) -> None:
        settings = SETTINGS.model_copy(update=changed)
        config = RigConfig(calibrate=settings, rays=rays)
        calibrate(bench.projector, bench.camera, place, config, only)

    return bench, place, run


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A calibrated bench with a gamma of 2.2."""
    bench, folder, run = begun(tmp_path_factory.mktemp("calibrated"), gamma=GAMMA)
    run()
    return bench, folder, run


def test_a_calibration_finds_the_bench(calibrated: Any) -> None:
    bench, folder, _ = calibrated
    calibration = load(folder.path)
    true = bench.camera.sensor
    assert calibration.camera["full_well_electrons"] == pytest.approx(
        true.full_well_electrons, rel=0.1
    )
    assert calibration.camera["read_noise_electrons"] == pytest.approx(5.0, rel=0.1)
    assert calibration.camera["black_level_counts"] == 64
    assert calibration.camera["response_gamma"] == 1
    light = np.linspace(0, 1, 256) ** GAMMA
    assert np.abs(calibration.projector_response - light).max() < 3e-3
    assert np.array_equal(calibration.layout.ray_of_pixel, bench.path.layout.ray_of_pixel)
    assert calibration.resampling.visible.all()
    assert set(calibration.facts) == set(STEPS)
    standings = {name: facts["standing"] for name, facts in calibration.facts.items()}
    assert set(standings.values()) <= {"good", "unknown"}, standings
    json.dumps(calibration.facts)
    recorded = calibration.settings
    assert recorded["sensor.bits"] == 12
    assert recorded["rays"] == list(RAYS)
    assert recorded["calibrate.codes"] == SETTINGS.codes
    assert "projector.options.settle_seconds" in recorded


def test_complete_steps_are_not_repeated(calibrated: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    bench, folder, run = calibrated
    before = {name: folder.manifest(name).read_bytes() for name in STEPS}

    def refuse(_: object) -> None:
        raise AssertionError("a picture was shown")

    monkeypatch.setattr(bench.projector, "show", refuse)
    run()
    assert before == {name: folder.manifest(name).read_bytes() for name in STEPS}


def test_an_interrupted_calibration_continues(tmp_path: Path) -> None:
    bench, folder, run = begun(tmp_path)
    expose, remaining = bench.camera.expose, [70]

    def failing() -> np.ndarray:
        remaining[0] -= 1
        if remaining[0] < 0:
            raise CaptureError("the camera is lost")
        return expose()

    bench.camera.expose = failing  # type: ignore[method-assign]
    with pytest.raises(CaptureError, match="lost"):
        run()
    done = [name for name in STEPS if folder.is_done(name)]
    assert done == ["latency", "steadiness", "scene", "dark", "linearity"]
    with pytest.raises(StoreError, match="light isn't complete"):
        finish(folder, SETTINGS)
    dark = folder.manifest("dark").stat().st_mtime_ns
    remaining[0] = 1000
    run(["light"])
    assert folder.manifest("dark").stat().st_mtime_ns == dark
    assert folder.is_done("light")
    assert not (folder.path / "calibration.json").exists()


def test_steps_affected_by_a_change_are_repeated_and_damage_is_found(tmp_path: Path) -> None:
    _, folder, run = begun(tmp_path)
    only = ["steadiness", "scene", "dark", "linearity"]
    run(only)
    first = {name: folder.conditions(name) for name in only}
    run(only, tolerance=0.05)
    assert folder.conditions("dark") == first["dark"]
    assert folder.conditions("linearity") != first["linearity"]
    for changed in ({"sensor": brighter(CAMERA, 2.0)}, {"seed": 1}):
        run(only, wedge_bench(RAYS, **changed), tolerance=0.05)
        assert folder.conditions("dark") != first["dark"]
    write_arrays(folder.store("dark"), {"black": np.zeros(3)}, {})
    with pytest.raises(IntegrityError, match="remove both"):
        folder.read("dark")


def test_needed_steps_are_measured_before_a_step(tmp_path: Path) -> None:
    _, folder, run = begun(tmp_path, (12, 12), (96, 96), (40, 42))
    run(["dark"])
    assert [name for name in STEPS if folder.is_done(name)] == ["steadiness", "dark"]
    before = folder.manifest("steadiness").stat().st_mtime_ns
    run(["linearity"])
    assert folder.manifest("steadiness").stat().st_mtime_ns == before


def test_a_rig_that_is_not_coaxial_has_no_rays(tmp_path: Path) -> None:
    _, folder, run = begun(tmp_path)
    run(coaxial=False)
    assert load(folder.path).layout is None
    assert set(folder.verdicts()) == set(STEPS) - {"rays", "symmetry"}
    with pytest.raises(InputError, match="is unknown for this rig"):
        run(["symmetry"], coaxial=False)


def test_a_complete_calibration_that_is_not_good_is_repeated(tmp_path: Path) -> None:
    # a light so strong that the shortest exposure is saturated nearly everywhere
    _, folder, run = begun(tmp_path, sensor=brighter(CAMERA, 200.0))
    run()
    assert folder.read("scene").verdict.standing == "poor"
    assert {folder.read(name).verdict.standing for name in ("rays", "symmetry")} == {"failed"}
    assert load(folder.path).layout is None
    before = folder.manifest("dark").stat().st_mtime_ns
    run()
    assert folder.manifest("dark").stat().st_mtime_ns > before


def test_the_verdict_names_a_needed_step_that_is_not_good(tmp_path: Path) -> None:
    bench, folder, run = begun(tmp_path)
    expose, full = bench.camera.expose, CAMERA.white_level
    bench.camera.expose = lambda: (expose() * (0.3 + expose() / full) / 1.3).astype(np.uint16)  # type: ignore[method-assign]
    run(["steadiness", "dark", "linearity", "light"])
    assert folder.read("linearity")["response_gamma"] == 1
    assert "NOT GOOD. Mend linearity first" in str(folder.read("light").verdict)


@pytest.mark.parametrize(
    ("first", "ambient", "longest", "message"),
    [(1e-3, 0.0, 0.05, "good. .*less noise"), (1e-3, 0.3, 0.004, "good. .*darken the room"),
     (2e-5, 0.0, 0.05, "NOT GOOD. Too dark.* times as long")],
)  # fmt: skip
def test_proposed_exposures_suit_a_dim_projector_and_the_room_light(
    tmp_path: Path, first: float, ambient: float, longest: float, message: str
) -> None:
    bench, folder, run = begun(tmp_path, sensor=replace(CAMERA, exposures=(first, 4 * first)))
    bench.path._ambient = np.float32(ambient)
    run(["steadiness", "scene", "dark"])
    scene, dark = (folder.read(name) for name in ("scene", "dark"))
    assert longest < scene["proposed_exposures_s"][-1] < min(2 * longest, 1.02 * dark["bearable_s"])
    assert re.match(message, str(scene.verdict))


@pytest.mark.parametrize(
    ("lamp", "room", "message"),
    [(0.0, 0.0, "sees no stripes of the projector"), (1.0, 5.0, "The all-off picture saturates")],
)
def test_a_rig_without_signal_gets_a_report(
    tmp_path: Path, lamp: float, room: float, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # shorter waits for light that never comes
    monkeypatch.setattr(latency, "LONGEST_SECONDS", 0.2)
    monkeypatch.setattr(latency, "PROBE_SECONDS", 0.05)
    bench, folder, run = begun(tmp_path, (12, 12), (96, 96), (40, 42), gamma=GAMMA)
    radiance = bench.camera._radiance
    bench.camera._radiance = lambda: lamp * radiance() + np.float32(room)
    run()
    verdicts = folder.verdicts()
    assert set(verdicts) == set(STEPS)
    assert message in verdicts["scene"]["verdict"]
    assert verdicts["rays"]["standing"] == "failed"
    text = build_calibration_report(folder).read_text(encoding="utf-8")
    assert "NOT MEASURED" in text
    assert message in text


def test_the_report_is_one_page(calibrated: Any) -> None:
    _, folder, _ = calibrated
    page = build_calibration_report(folder)
    text = page.read_text(encoding="utf-8")
    for name in STEPS:
        assert f'id="{name}"' in text
        assert (folder.path / "tables" / f"{name}.csv").is_file()
    assert [*STEPS] == sorted(STEPS, key=lambda name: text.index(f'id="{name}"'))
    assert "<b>Verdicts.</b> </caption>" not in text
    steady = folder.read("steadiness")
    assert steady.facts["lit_pictures"] == len(steady["gain"]) < steady.facts["pictures"]
    assert f"{steady.facts['lit_pictures']} check pictures" in steady.verdict.text
    figure = _steadiness(steady)
    (legend,) = figure.legends
    assert len(legend.get_texts()) == steady["judged"].sum()
    lines = [line for line in figure.axes[0].lines if len(line.get_ydata()) > 2]
    shown = np.concatenate([line.get_ydata() for line in lines])
    assert np.ptp(shown) < 100 * 2 * CALIBRATION.light  # exposures below the noise are omitted
    shown = [path.stat().st_size > 5000 for path in (folder.path / "figures").glob("*.png")]
    assert all(shown)
    assert text.count("data:image/png;base64") == len(shown) == len(STEPS) - 1
    assert "http" not in text.replace("http://www.w3.org", "")


def test_a_simulated_rig_has_nothing_to_calibrate(tmp_path: Path) -> None:
    scene = {"kind": "plane", "surfaces": ["white"]}
    config = parse_rig_config({"kind": "simulated", "scene": scene}, "rig.yaml")
    with pytest.raises(ConfigError, match="simulated"):
        calibrate_rig(config, tmp_path)
