"""Code blocks of the how-to pages run as they are, in the folder that the page describes."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
import pytest
from tests.results.transports import transport_of
from typer.testing import CliRunner

import rfpipe
from rfpipe.cli import app
from rfpipe.fitting.codes import code_patterns
from rfpipe.scenes import Pinhole, planes_scene

ROOT = Path(__file__).parents[2]


def photographs(folder: Path) -> None:
    """Write photographs of Gray code and of a ball under 12 lights, and an even panorama."""
    camera, lamp = Pinhole((40, 40)), Pinhole((100, 100), (1.72, 0, 0.54), (0, 0, 3))
    scene = planes_scene("wedge_120", ("white", "white"), camera.shape, projector=lamp, channels=1)
    light = np.r_[np.full(28, 0.5), 1, 0]
    patterns = [read() for read in code_patterns("gray:100x100", len(light), light).readers]
    pictures = scene.apply(np.reshape(patterns, (len(light), -1)).astype(np.float32))
    write(folder / "table", 200 * pictures.reshape(-1, *camera.shape, 1) / pictures.max())

    lights = directions(12)
    x, y = np.meshgrid(np.linspace(-1, 1, 24), np.linspace(1, -1, 24))
    normals = np.stack([x / 2, y / 2, np.sqrt(1 - (x**2 + y**2) / 4)], axis=-1)
    shading = np.maximum(np.moveaxis(normals @ lights.T, -1, 0), 0)
    write(folder / "cat", 200 * np.repeat(shading[..., None], 3, axis=-1))
    np.savetxt(folder / "cat" / "lights.txt", lights, header="12", comments="")
    assert oiio.ImageBuf(np.full((16, 32, 3), 0.5, np.float32)).write(str(folder / "sky.exr"))


def directions(count: int) -> np.ndarray:
    """Return the directions of lights all over the camera's half of the sphere, (count, 3)."""
    angles = np.arange(count) * np.pi * (3 - 5**0.5)
    heights = 1 - 0.9 * (np.arange(count) + 0.5) / count
    rings = np.sqrt(1 - heights**2)
    return np.stack([rings * np.cos(angles), rings * np.sin(angles), heights], axis=1)


def write(folder: Path, pictures: np.ndarray) -> None:
    """Write pictures with noise, (count, height, width, channels), as numbered PNG files."""
    folder.mkdir()
    noisy = pictures + 10 + np.random.default_rng(1).standard_normal(pictures.shape)
    for index, picture in enumerate(np.clip(np.rint(noisy), 0, 255).astype(np.uint8)):
        name = str(folder / f"{index + 1:02d}.png")
        assert oiio.ImageBuf(np.ascontiguousarray(picture)).write(name)


def a_transport(folder: Path) -> None:
    """Write a transport, pictures of a dome, and a panorama."""
    photographs(folder)
    (folder / "cat").rename(folder / "FOLDER")
    transport_of("symmetric").save(folder / "transport.zarr")
    assert oiio.ImageBuf(str(folder / "sky.exr")).write(str(folder / "sky.hdr"))


def names_of_uses() -> dict[str, Any]:
    transport = transport_of("symmetric")
    pattern = np.random.default_rng(1).random(transport.projector_shape)
    picture = transport.relight(pattern)
    return {
        "transport": transport, "pattern": pattern, "picture": picture, "row": 10, "column": 12,
        "panorama": np.ones((16, 32, 3)), "rfpipe": rfpipe,
    }  # fmt: skip


def light_field(folder: Path) -> None:
    """Write the settings that the page on light fields begins with."""
    page = (ROOT / "docs" / "light_fields.md").read_text("utf-8")
    block = re.findall(r"^```yaml\n(.*?)^```", page, re.M | re.S)[0]
    (folder / "field.yaml").write_text(block)


def niche(folder: Path) -> None:
    """Write a scene of one's own and its settings."""
    shutil.copy(ROOT / "tests" / "examples" / "niche.py", folder)
    scene = '{kind: "niche.py:Niche", shape: [16, 18], brick: 0.25}'
    (folder / "niche.yaml").write_text(f"scenes: {{niche: {scene}}}\nmethods: {{near_far: {{}}}}\n")


def settings(folder: Path) -> None:
    """Write the settings of a run of one's own."""
    (folder / "config").mkdir()
    (folder / "config" / "mine.yaml").write_text("scenes: {vase: {kind: plane, shape: [16, 18]}}\n")


@dataclass(frozen=True)
class HowTo:
    """A page, and what its blocks need.

    Attributes
    ----------
    prepare : function
        Writes the files with which the page begins into a folder.
    names : function
        Returns the variables with which its Python blocks begin.
    elsewhere : mapping
        A part of each block that isn't run here, to the test that runs it, or to the reason why
        none does.
    """

    prepare: Callable[[Path], None] = lambda folder: None
    names: Callable[[], dict[str, Any]] = dict
    elsewhere: Mapping[str, str] = field(default_factory=dict)


PAGES = {
    "clusters": HowTo(
        elsewhere={
            "--profile": "workflow/test_slurm",
            "set-resources": "settings of a cluster's profile",
            "groups:": "settings of a cluster's profile",
        }
    ),
    "light_fields": HowTo(light_field),
    "night": HowTo(settings, elsewhere={"--retake": "unit/test_retake"}),
    "photographs": HowTo(photographs, lambda: {"row": 20, "column": 20}),
    "rig": HowTo(elsewhere={"": "workflow/test_rig_document"}),
    "scenes": HowTo(
        niche,
        elsewhere=dict.fromkeys(
            ("class Niche", "from niche", "from rfpipe import", "SceneContract"),
            "unit/test_scene_document",
        ),
    ),
    "uses": HowTo(a_transport, names_of_uses, {"import torch": "unit/test_interop"}),
}


def blocks(page: str) -> list[tuple[str, str]]:
    """Return language and text of each block of commands or Python of a page, in their order."""
    text = (ROOT / "docs" / f"{page}.md").read_text("utf-8")
    block = re.compile(r"^```(sh|python)\n(.*?)^```|(?<=\n\n)((?: {4}\S[^\n]*\n)+)", re.M | re.S)
    fences = re.sub(r"^```(?!sh|python)(\w+)\n.*?^```", "", text, flags=re.M | re.S)
    return [
        (found[1], found[2]) if found[1] else ("sh", re.sub(r"^ {4}", "", found[3], flags=re.M))
        for found in block.finditer(fences)
    ]


def run(command: str) -> None:
    """Run a command of rfpipe; workflows in a process of their own."""
    program, *words = shlex.split(command, comments=True)
    assert Path(program).name == "rfpipe", command
    if words[0] == "run":
        subprocess.run([sys.executable, "-m", "rfpipe.cli", *words], check=True)
        return
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, (command, done.output, done.exception)


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_blocks_run_in_their_order(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    how_to = PAGES[page]
    how_to.prepare(tmp_path)
    monkeypatch.chdir(tmp_path)
    names = how_to.names()
    for language, text in blocks(page):
        if any(part in text for part in how_to.elsewhere):
            continue
        if language == "python":
            exec(compile(text, page, "exec"), names)
        else:
            for line in text.replace("\\\n", "").splitlines():
                run(line)


@pytest.mark.parametrize("page", PAGES)
def test_blocks_that_run_elsewhere_have_a_test_or_a_reason(page: str) -> None:
    texts = [text for _, text in blocks(page)]
    assert texts
    for part, place in PAGES[page].elsewhere.items():
        assert any(part in text for text in texts), part
        assert " " in place or (ROOT / "tests" / f"{place}.py").is_file(), place
