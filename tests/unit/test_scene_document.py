"""docs/scenes.md: its snippets run, and its example is a valid scene."""

import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rfpipe.config import SceneSettings
from rfpipe.scenes import RadiosityScene, scene_from_config
from rfpipe.testing import SceneContract

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "tests" / "examples"
PAGE = (ROOT / "docs" / "scenes.md").read_text("utf-8")
SNIPPETS = re.findall(r"^```python\n(.*?)^```", PAGE, re.M | re.S)
WHOLE = [snippet for snippet in SNIPPETS if "..." not in snippet]


def niche(**options: Any) -> RadiosityScene:
    made = scene_from_config(SceneSettings.of(f"{EXAMPLES / 'niche.py'}:Niche", **options))
    assert isinstance(made, RadiosityScene)
    return made


class TestNiche(SceneContract):
    def make_scene(self):
        return niche(shape=(6, 8))


class TestGreyNiche(SceneContract):
    def make_scene(self):
        return niche(shape=(6, 8), channels=1)


def test_the_example_has_a_ball_bricks_and_light_between_them() -> None:
    scene = niche(shape=(24, 27))
    names = [surface.name for surface in scene.points.surfaces]
    assert set(np.unique(scene.points.surface)) == set(range(len(names)))
    transport = scene.dense(1)
    direct = np.diag(transport)
    assert 0.05 < 1 - direct.sum() / transport.sum() < 0.6
    assert len(np.unique(scene.albedo.reshape(-1, 3), axis=0)) == 3


def test_excerpts_equal_the_example() -> None:
    lines = (EXAMPLES / "niche.py").read_text("utf-8").splitlines()
    excerpts = [snippet for snippet in SNIPPETS if snippet not in WHOLE]
    assert len(excerpts) == 1
    for line in excerpts[0].splitlines():
        assert line.strip() == "..." or line in lines


@pytest.mark.slow
@pytest.mark.parametrize("number", range(len(WHOLE)))
def test_snippets_run_in_the_folder_of_the_examples(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for example in ("niche.py", "frosted_glass.py"):
        shutil.copy(EXAMPLES / example, tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    names: dict[str, Any] = {"__name__": "snippet"}
    exec(compile(WHOLE[number], f"snippet {number}", "exec"), names)
    if "TestFrostedGlass" in names:
        names["TestFrostedGlass"]().test_light()
        return
    scene = names.get("scene") or scene_from_config(names["settings"])
    pattern = np.zeros(scene.projector_shape, np.float32)
    pattern[:, : pattern.shape[1] // 2] = 1
    truth = scene.apply(pattern[None])[0].ravel()
    relit = names["result"].transport.relight(pattern).ravel()
    assert np.linalg.norm(relit - truth) < 0.05 * np.linalg.norm(truth)
