"""`capture.placing`: the command that places a scene in front of the rig."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

from rfpipe.config import load_config
from rfpipe.errors import CaptureError, ConfigError
from rfpipe.stages import capture, rig_sources
from rfpipe.stages.context import CaptureContext
from rfpipe.stages.rig_sources import RemoteSource, place_scene
from rfpipe.storage.files import FolderStorage

WRITE = "import os, sys; open(sys.argv[1], 'a').write(os.environ['RFPIPE_SCENE'] + chr(10))"


def placed_by(folder: Path) -> tuple[str, Path]:
    """Return a command that appends scene names to a file, and the path of the file."""
    notes = folder / "the notes.txt"
    return f'{sys.executable} -c "{WRITE}" "{notes}"', notes


def test_job_places_each_scene_once(tmp_path: Path) -> None:
    command, notes = placed_by(tmp_path)
    for scene in ("jug", "jug", "cup"):
        place_scene(command, scene)
    assert notes.read_text().split() == ["jug", "cup"]


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        (f'{sys.executable} -c "raise SystemExit(3)"', "exit status 3"),
        ("no-such-gantry --to", "No such file"),
    ],
)
def test_failed_placing_prevents_the_capture(command: str, reason: str) -> None:
    for _ in range(2):  # a failure is not remembered
        with pytest.raises(CaptureError, match="jug was not put before the rig") as caught:
            place_scene(command, "jug")
        assert reason in str(caught.value)
        assert "Nothing was captured" in str(caught.value)


def test_scene_is_placed_before_the_rig_is_connected(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, notes = placed_by(tmp_path)
    placed: list[str] = []

    def connect(*_: Any, **__: Any) -> None:
        placed.append(notes.read_text())
        raise CaptureError("no rig here")

    monkeypatch.setattr(rig_sources, "RemoteRig", connect)
    monkeypatch.setenv("RFPIPE_TOKEN", "a" * 32)
    rays = {"camera_shape": (4, 5), "projector_shape": (4, 5), "channels": 3}
    source = RemoteSource(
        rays, "http://localhost:1", None, patience_seconds=0, placing=placed_by(tmp_path)[0]
    )
    context = CaptureContext(FolderStorage(tmp_path / "jug/dual"), rig_source=source)
    with pytest.raises(CaptureError, match="no rig here"):
        capture.run(context, 0)
    assert placed == ["jug\n"]


def test_several_scenes_need_a_placing_command(tmp_path: Path) -> None:
    settings = tmp_path / "run.yaml"
    text = "collection: list.csv\nmethods: {dual: {}}\ncapture: {rig: remote%s}\n"
    (tmp_path / "list.csv").write_text("name,kind,shape\njug,captured,6 x 8\ncup,captured,6 x 8\n")
    settings.write_text(text % "")
    with pytest.raises(ConfigError, match=r"set capture\.placing, a command"):
        load_config(settings)
    settings.write_text(text % ", placing: python place.py")
    assert load_config(settings).capture.placing == "python place.py"
