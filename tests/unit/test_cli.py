"""The commands on a small transport of rank 1 per channel: T = x x^T."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.rigs.known_matrix import run

from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.cli import main
from rfpipe.config import Config
from rfpipe.config.schema import schema_of
from rfpipe.pictures.images import read_image, write_image
from rfpipe.scenes.relighting import relighting_patterns
from rfpipe.store import write_manifest
from rfpipe.transport import save_transport
from rfpipe.transport.hierarchical.leaves import LeafSet
from rfpipe.transport.hierarchical.transport import HierarchicalTransport

SHAPE = (4, 6)
CONFIG = Path(__file__).parents[2] / "config" / "config.yaml"


@pytest.fixture
def factors() -> NDArray[np.float32]:
    """The factor x of each channel, in image order, shape (3, 24)."""
    return np.random.default_rng(5).random((3, 24), dtype=np.float32)


@pytest.fixture
def transport(tmp_path: Path, factors: NDArray[np.float32]) -> Path:
    tree = BlockTree(RayDomain(SHAPE))
    root = LeafSet(0, np.zeros(1, np.int32), np.zeros(1, np.int32), factors[:, tree.order])
    rows = [{"level": 0, "patterns": 1, "nodes": 1, "empty": 0, "rank1": 1}]
    path = tmp_path / "transport.zarr"
    save_transport(HierarchicalTransport.from_leaf_sets(tree, 3, rows, [root]), path)
    return path


def picture(path: Path, weights: NDArray[np.float32]) -> Path:
    write_image(path, weights.reshape(*weights.shape[:2], -1))
    return path


@pytest.fixture
def failure(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., str]:
    """Return a function that runs a failing command and returns its message on stderr."""

    def failed(*arguments: object) -> str:
        monkeypatch.setattr(sys, "argv", ["rfpipe", *map(str, arguments)])
        with pytest.raises(SystemExit) as caught:
            main()
        assert caught.value.code == 1
        output = capsys.readouterr().err
        assert output.startswith("rfpipe: ")
        assert "Traceback" not in output
        return output

    return failed


def test_plan_lists_each_acquisition_with_its_rays_and_patterns() -> None:
    planned = run("plan", CONFIG)
    assert "valid. 6 acquisitions. One job per stage, since a scene has 10,368 rays" in planned
    (room,) = (line.split() for line in planned.splitlines() if " auto " in line and "room" in line)
    assert room[:5] == ["room", "auto", "10,368", "33", "51"]


def test_schema_equals_that_of_the_model() -> None:
    assert json.loads(run("settings", "schema")) == schema_of(Config)


def test_info_shows_shape_bytes_and_levels(transport: Path) -> None:
    text = run("info", transport)
    assert "camera     4 x 6 = 24 rays" in text
    assert "channels   3" in text
    assert "patterns" in text
    assert "rank1" in text


@pytest.mark.parametrize(
    ("name", "options"),
    [("file", ()), ("file", ("--dual",)), ("file", ("--level", 0)), ("white", ()),
     ("vertical_bar", ())],
)  # fmt: skip
def test_relight_writes_the_radiance(
    transport: Path,
    factors: NDArray[np.float32],
    tmp_path: Path,
    name: str,
    options: tuple[object, ...],
) -> None:
    named = {name: light[..., None] for name, light in relighting_patterns(SHAPE).items()}
    named["white"] = np.ones((*SHAPE, 1), np.float32)
    named["file"] = np.random.default_rng(6).random((*SHAPE, 3), dtype=np.float32)
    pattern = picture(tmp_path / "pattern.exr", named["file"]) if name == "file" else name
    output = tmp_path / "image.exr"
    run("relight", transport, "--pattern", pattern, "--output", output, *options)
    weights = np.broadcast_to(named[name], (*SHAPE, 3)).reshape(-1, 3)
    energy = np.einsum("cr,rc->c", factors, weights)
    expected = (factors * energy[:, None]).T.reshape(*SHAPE, 3)
    np.testing.assert_allclose(read_image(output), expected, rtol=1e-5)


def test_an_unknown_pattern_is_refused(
    transport: Path, tmp_path: Path, failure: Callable[..., str]
) -> None:
    output = tmp_path / "image.exr"
    text = failure("relight", transport, "--pattern", "barr", "--output", output)
    assert "there is no pattern or file barr" in text


def test_relight_with_white_light_as_png(
    transport: Path, factors: NDArray[np.float32], tmp_path: Path
) -> None:
    pattern = picture(tmp_path / "pattern.png", np.ones((*SHAPE, 1), np.float32))
    output = tmp_path / "image.png"
    run("relight", transport, "--pattern", pattern, "--output", output, "--white", 20)
    expected = (factors * factors.sum(axis=1, keepdims=True)).T.reshape(*SHAPE, 3) / 20
    shown = np.where(
        expected <= 0.0031308, 12.92 * expected, 1.055 * expected ** (1 / 2.4) - 0.055
    ).clip(0, 1)
    np.testing.assert_allclose(read_image(output), shown, atol=1 / 255)


def test_a_pattern_of_another_size_is_refused(
    transport: Path, tmp_path: Path, failure: Callable[..., str]
) -> None:
    pattern = picture(tmp_path / "pattern.exr", np.ones((6, 4, 1), np.float32))
    output = tmp_path / "image.exr"
    text = failure("relight", transport, "--pattern", pattern, "--output", output)
    assert "6 x 4 pixels" in text
    assert "expected 4 x 6" in text
    assert not output.exists()


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("--host", "0.0.0.0"), "0.0.0.0 is not a loopback address"),
        ((), "RFPIPE_TOKEN is not set"),
        (("--token-file", "absent.token"), "absent.token: can't be read as a token file"),
    ],
)
def test_serve_refuses_before_a_device_is_opened(
    monkeypatch: pytest.MonkeyPatch,
    failure: Callable[..., str],
    arguments: tuple[str, ...],
    expected: str,
) -> None:
    monkeypatch.delenv("RFPIPE_TOKEN", raising=False)
    text = failure("serve", CONFIG.with_name("rig.yaml"), *arguments)
    assert expected in text


def test_scenes_are_listed_with_their_options() -> None:
    text = run("settings", "scenes")
    assert "wedge_120: Two planes that meet at 120 degrees" in text
    assert "    surfaces ([]): Each white (albedo 0.8) or texture" in text
    assert "    projector (null): A projector separate from the camera" in text
    assert text.startswith("every kind:\n    shape ([62,70]): Height and width")
    assert text.count("    settings ({}): ") == 1
    assert "Undefined" not in text


RIGS = [CONFIG.with_name(name) for name in ("rig.yaml", "bench.yaml")]


@pytest.mark.parametrize("rig", [*RIGS, *sorted(CONFIG.parent.glob("rigs/*"))])
def test_validate_recognises_a_rig(rig: Path) -> None:
    assert "rfpipe calibrate and serve" in run("plan", rig)


def test_a_transport_of_another_run_is_not_relit(
    transport: Path, tmp_path: Path, failure: Callable[..., str]
) -> None:
    write_manifest(transport.with_suffix(".json"), {"digest": "0" * 32})
    text = failure(
        "relight", transport, "--pattern", "white", "--output",
        tmp_path / "image.exr",
    )  # fmt: skip
    assert f"remove {transport.with_suffix('.json')} and run again" in text


def test_run_checks_settings_in_its_folder_and_prints_the_report(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    failure: Callable[..., str],
) -> None:
    monkeypatch.chdir(tmp_path)
    report = Path("elsewhere/results/report/index.html")
    report.parent.mkdir(parents=True)
    report.touch()
    Path("Snakefile").write_text("rule all:\n    output: 'done.txt'\n    shell: 'touch {output}'\n")
    Path("settings.yaml").write_text("scenes: {glass: {kind: 'glass.py:Glass'}}\n")
    options = ("--configfile", "settings.yaml", "--cores", "1")
    output = failure("run", *options, "--directory", "elsewhere")
    assert f"no file glass.py in {tmp_path / 'elsewhere'}" in output
    examples = Path(__file__).parents[1] / "examples"
    glass = (examples / "frosted_glass.py").read_text().replace("FrostedGlass", "Glass")
    Path("elsewhere/glass.py").write_text(glass)
    assert "glass" in run("plan", "settings.yaml", "--directory", "elsewhere")
    command = ["rfpipe", "run", *options, "--directory", "elsewhere"]
    monkeypatch.setattr(sys, "argv", command)
    with pytest.raises(SystemExit, match=r"^0$"):
        main()
    assert Path("elsewhere/done.txt").exists()
    assert capsys.readouterr().out.endswith(f"report: {report}\n")


def test_make_unlock_passes_the_folder_of_the_run() -> None:
    command = ["make", "-n", "unlock", "ARGS=--directory mine --configfile mine.yaml"]
    result = subprocess.run(
        command, cwd=CONFIG.parents[1], check=True, capture_output=True, text=True
    )
    assert "snakemake --unlock --directory mine --configfile mine.yaml" in result.stdout
