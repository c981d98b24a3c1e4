"""A user-defined scene in one file outside the package, selected by settings."""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from tests.workflow.harness import GLASS, Workflow

from rfpipe import open_transport, plugins
from rfpipe.config import SceneSettings, parse_config
from rfpipe.errors import ConfigError, InputError
from rfpipe.scenes import scene_from_config
from rfpipe.testing import SceneContract

EXAMPLE = Path(__file__).parents[1] / "examples" / "frosted_glass.py"
OPTIONS = {name: value for name, value in GLASS.items() if name != "kind"}


def made(**options):
    settings = SceneSettings.of(f"{EXAMPLE}:FrostedGlass", **{**OPTIONS, **options})
    return scene_from_config(settings)


class TestFrostedGlass(SceneContract):
    def make_scene(self):
        return made(channels=3)


@pytest.mark.slow
def test_it_runs_in_the_workflow_with_rfpipe_s_own(of_ones_own: Workflow) -> None:
    workflow = of_ones_own
    page = workflow.path("report/index.html").read_text(encoding="utf-8")
    assert "frosted_glass.py:FrostedGlass" in page.replace("frosted glass.py", "frosted_glass.py")
    relit = open_transport(workflow.path("glass/brute_force/transport.zarr"))
    spot = np.zeros((6, 8), np.float32)
    spot[2, 3] = 1
    expected = made().apply(spot[None])[0].reshape(6, 8, 1)
    assert np.count_nonzero(expected > 0.01 * expected.max()) > 9
    np.testing.assert_allclose(relit.relight(spot), expected, atol=5e-3 * expected.max())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"blur": 0}, "scenes.glass.blur is 0; it should be above 0"),
        ({"blurr": 1}, "scenes.glass.blurr is unknown; did you mean blur?"),
        ({"kind": f"{EXAMPLE}:Glass"}, "has no 'Glass'"),
        ({"kind": "absent.py:Glass"}, "there is no file absent.py"),
    ],
)
def test_mistakes_in_its_settings_are_explained(change, message: str) -> None:
    glass = {"kind": f"{EXAMPLE}:FrostedGlass", **OPTIONS, **change}
    with pytest.raises(ConfigError) as caught:
        parse_config({"scenes": {"glass": glass}}, "mine.yaml")
    assert message in str(caught.value)


BROKEN = {
    "syntax": ("x = 1\nclass Mine(:\n", "mine.py, line 2)", "correct the code"),
    "import": (
        "\nimport absent_package\n",
        "mine.py, line 2)",
        "install absent_pac",
    ),
    "name": ("from time import absent\n", "mine.py, line 1)", "correct the code"),
    "value": ("x = 1\n\ny = 1 / 0\n", "mine.py, line 3)", "correct the code"),
}


@pytest.mark.parametrize("form", ["mine.py:Mine", "{module}:Mine"])
@pytest.mark.parametrize("case", BROKEN)
@pytest.mark.parametrize("group", [plugins.SCENES, plugins.METHODS, plugins.CAMERAS])
def test_code_that_cannot_be_imported_is_named_with_its_line(
    group: str, case: str, form: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code, place, remedy = BROKEN[case]
    module = f"m{abs(hash((group, case, tmp_path)))}_mine"
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    for name in ("mine", module):
        (tmp_path / f"{name}.py").write_text(code)
    for look_up in (plugins.find, plugins.sources_of):
        with pytest.raises(InputError) as caught:
            look_up(group, form.format(module=module))
        assert place in str(caught.value)
        assert remedy in str(caught.value)


def test_an_error_in_a_scene_s_code_is_reported_as_a_mistake_of_settings(tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text("class Mine(:\n")
    with pytest.raises(ConfigError, match=r"scenes\.glass.*SyntaxError.*mine\.py, line 1"):
        parse_config({"scenes": {"glass": {"kind": f"{file}:Mine"}}}, "mine.yaml")


@pytest.mark.slow
def test_the_niche_of_the_document_runs_in_the_workflow(tmp_path: Path) -> None:
    page = (EXAMPLE.parents[2] / "docs" / "scenes.md").read_text("utf-8")
    (block,) = (b for b in re.findall(r"```yaml\n(.*?)```", page, re.S) if "niche.py" in b)
    settings = yaml.safe_load(block)
    settings["scenes"]["niche"]["shape"] = [12, 14]
    workflow = Workflow(tmp_path)
    shutil.copy(EXAMPLE.with_name("niche.py"), workflow.folder)
    workflow.configure(**settings)
    workflow.run()
    results = pd.read_csv(workflow.path("report/tables/results.csv"))
    assert results["scene"].tolist() == ["niche"]
    assert results["mean_error"].max() < 0.03
