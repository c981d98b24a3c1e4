"""Messages about six faults, in calibration, capture and offline import.

The column of captures is in `tests.device.test_faults_in_capture`.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import OpenImageIO as oiio
import pytest
import yaml
from tests.rigs.calibration_bench import CAMERA, brighter, wedge_bench
from tests.rigs.simulated_devices import SimulatedCamera, SimulatedProjector
from typer.testing import CliRunner

from rfpipe.calibration import latency
from rfpipe.calibration.folder import CalibrationFolder
from rfpipe.calibration.run import calibrate
from rfpipe.cli import app
from rfpipe.config import CalibrationConfig, RigConfig, SceneSettings
from rfpipe.pictures import read_picture
from rfpipe.rigs.offline import read_sheet
from rfpipe.scenes import scene_from_config
from rfpipe.testing import faults

Devices = tuple[Any, Any]


class Case(NamedTuple):
    """A fault, and a regular expression for the message of each step."""

    inject: Callable[[Any, Any, int], Devices]
    message: str


FAULTS: dict[str, Case] = {
    "late": Case(
        lambda projector, camera, after: (projector, faults.LateCamera(camera, after)),
        r"frames show the previous picture.*(queue|settle_seconds|latency)",
    ),
    "gain": Case(
        lambda projector, camera, after: (projector, faults.jittering_gain(camera, after)),
        r"gain changes from picture to picture.*automatic gain",
    ),
    "flicker": Case(
        lambda projector, camera, after: (projector, faults.flickering_lamp(camera, after)),
        r"flicker.*whole periods",
    ),
    "room": Case(
        lambda projector, camera, after: (projector, faults.changing_room_light(camera, after)),
        r"room's light chang.*%",
    ),
    "drift": Case(
        lambda projector, camera, after: (projector, faults.drifting_lamp(camera, after)),
        r"lamp's light chang.*%",
    ),
    "geometry": Case(
        lambda projector, camera, after: (projector, faults.moved_camera(camera, after)),
        r"moved",
    ),
}
"""By name; ``inject(projector, camera, after)`` returns the devices with the fault."""

WRONG_REMEDIES = re.compile(
    r"lens open|[Rr]aise the (camera's )?black|[Aa]lign the|centres|divide_out_drift|"
    r"Set \S*settle_seconds|e\+0\d"
)
"""Remedies of other faults."""

RAYS = (12, 12)
SETTINGS = CalibrationConfig(dark_frames=4, levels=6, codes=17, symmetry_patterns=6)


def verdicts_of(
    folder: Path, case: Case | None, after: int = 0, **options: Any
) -> dict[str, dict[str, str]]:
    """Calibrate a bench before a wedge, which has a fault after some brackets."""
    bench = wedge_bench(RAYS, (96, 96), (40, 42), **options)
    devices: Devices = (bench.projector, bench.camera)
    if case is not None:
        devices = case.inject(*devices, after)
    place = CalibrationFolder(folder)
    calibrate(*devices, place, RigConfig(calibrate=SETTINGS, rays=RAYS))
    return place.verdicts()


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Do not wait for light that never settles."""
    monkeypatch.setattr(latency, "LONGEST_SECONDS", 0.3)
    monkeypatch.setattr(latency, "PROBE_SECONDS", 0.0)


MORE = {
    "late by a frame": FAULTS["late"]._replace(
        inject=lambda projector, camera, after: (
            projector,
            faults.LateCamera(camera, after, frames=1),
        )
    ),
    "weak room light": FAULTS["room"]._replace(
        inject=lambda projector, camera, after: (
            projector,
            faults.changing_room_light(camera, after, light=0.005),
        )
    ),
    "mirrored": FAULTS["geometry"]._replace(
        inject=lambda projector, camera, after: (faults.mirrored(projector, after), camera)
    ),
    "half dark": FAULTS["geometry"]._replace(
        inject=lambda projector, camera, after: (faults.half_dark(projector, after), camera)
    ),
}
"""Variants that calibration detects as well."""


@pytest.mark.slow
@pytest.mark.parametrize("after", [0, 25, 100])
@pytest.mark.parametrize("name", [*FAULTS, *MORE])
def test_calibration_names_the_fault(name: str, after: int, tmp_path: Path) -> None:
    case = {**FAULTS, **MORE}[name]
    if case.message == "moved" and not after:
        pytest.skip("what lies so from the beginning is no motion")
    verdicts = verdicts_of(tmp_path, case, after)
    texts = {
        step: verdict["verdict"]
        for step, verdict in verdicts.items()
        if re.search(case.message, verdict["verdict"])
    }
    assert texts, verdicts
    first = next(iter(texts))
    earlier = list(verdicts.values())[: list(verdicts).index(first)]
    assert all(verdict["standing"] in ("good", "unknown") for verdict in earlier), verdicts
    if name != "drift":
        assert verdicts[first]["standing"] in ("poor", "failed")
        for step, verdict in verdicts.items():
            if step != "rays":  # takes no pictures
                assert not WRONG_REMEDIES.search(verdict["verdict"]), (step, verdict)


OFFLINE = {
    "drift": FAULTS["drift"]._replace(
        inject=lambda projector, camera, after: (
            projector,
            faults.drifting_lamp(camera, after, brackets=10),
        )
    ),
    "room": FAULTS["room"]._replace(
        inject=lambda projector, camera, after: (
            projector,
            faults.changing_room_light(camera, after, seconds=60),
        )
    ),
}
"""Faults that develop within a sheet of 20 pictures."""


class Desk:
    """A photographer with a camera and a projector, each pixel a ray."""

    exposures = CAMERA.exposures

    def __init__(self, folder: Path, seed: int = 0) -> None:
        self.folder = folder
        scene = scene_from_config(
            SceneSettings.of("wedge", surfaces=("white", "texture"), shape=(16, 16), channels=1)
        )
        self.projector: Any = SimulatedProjector((16, 16))
        light = lambda: scene.apply(self.projector.light.reshape(1, -1))[0].reshape(16, 16, 1)  # noqa: E731
        self.camera: Any = SimulatedCamera(light, (16, 16), 1, CAMERA, seed)
        self.settings = folder / "mine.yaml"
        self.settings.write_text(yaml.safe_dump({
            "scenes": {"desk": {"kind": "captured", "shape": [16, 16], "channels": 1}},
            "methods": {"symmetric": {}},
            "camera": {"exposures": list(CAMERA.exposures)},
            "capture": {"rig": "offline"},
        }))  # fmt: skip

    def run(self, *arguments: object) -> str:
        """Return the output of a command, or its error."""
        done = CliRunner().invoke(app, [str(argument) for argument in arguments])
        return done.output if done.exception is None else str(done.exception)

    def sheet(self) -> Path:
        """Return the next sheet to be taken."""
        self.run("patterns", self.settings, "-o", self.folder / "p", "--results", self.folder / "r")
        return sorted(path for path in self.folder.glob("p/desk_*") if path.is_dir())[-1]

    def photograph(self, sheet: Path) -> None:
        """Show and take all pictures of a sheet."""
        (sheet / "pictures").mkdir(exist_ok=True)
        number = 0
        for shown in read_sheet(sheet).shown:
            self.projector.show(read_picture(sheet / shown.file).pixels[..., 0] / np.float32(255))
            for seconds, frame in zip(self.exposures, self.camera.expose(), strict=True):
                picture = oiio.ImageBuf(np.ascontiguousarray(frame))
                picture.specmod().attribute("ExposureTime", float(seconds))
                assert picture.write(str(sheet / "pictures" / f"IMG_{number}.tif"))
                number += 1


@pytest.mark.slow
@pytest.mark.parametrize("after", [0, 7])
@pytest.mark.parametrize("name", FAULTS)
def test_offline_import_names_the_fault(name: str, after: int, tmp_path: Path) -> None:
    desk = Desk(tmp_path)
    inject = {**FAULTS, **OFFLINE}[name].inject
    desk.projector, desk.camera = inject(desk.projector, desk.camera, after)
    sheet = desk.sheet()
    desk.photograph(sheet)
    output = desk.run("import", sheet)
    if name == "geometry" and after == 0:
        assert "moved" not in output  # from the beginning: no motion
        return
    assert re.search(FAULTS[name].message, output), output
    assert not WRONG_REMEDIES.search(output)


ALARMS = re.compile(
    "|".join([*(case.message for case in FAULTS.values()), "changes? from picture to"])
)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20))
def test_a_clean_calibration_raises_no_alarm(seed: int, tmp_path: Path) -> None:
    sensors = [
        CAMERA,
        replace(CAMERA, exposures=(1 / 64, 1 / 4)),
        replace(CAMERA, bits=8),
        brighter(CAMERA, 0.1),
    ]
    gamma = 2.2 if seed % 2 else 1.0
    verdicts = verdicts_of(tmp_path, None, seed=seed, sensor=sensors[seed % 4], gamma=gamma)
    assert {verdict["standing"] for verdict in verdicts.values()} <= {"good", "unknown"}, verdicts
    texts = [verdict["verdict"] for verdict in verdicts.values()]
    assert not [text for text in texts if ALARMS.search(text)]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_clean_pictures_are_imported(seed: int, tmp_path: Path) -> None:
    desk = Desk(tmp_path, seed)
    sheet = desk.sheet()
    desk.photograph(sheet)
    assert "brackets imported" in desk.run("import", sheet)
