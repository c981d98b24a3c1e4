"""Reports of small results folders show everything that exists, and nothing else."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pandas as pd
import pytest
from figures.__main__ import run as run_script
from figures.common import Size
from tests.results.report_folders import BOTH, FIELD, GREY, Page, acquired, benchmarked, tables_of

from rfpipe.config import Config
from rfpipe.config.capture import VerificationConfig
from rfpipe.errors import StoreError
from rfpipe.pictures.images import read_image, srgb
from rfpipe.provenance import fingerprint, versions
from rfpipe.relighting import KINDS
from rfpipe.report import build_report, check_page
from rfpipe.report.build import make_sections
from rfpipe.report.drawing import Panel, difference, draw
from rfpipe.report.glance import result_of
from rfpipe.report.inputs import load_inputs
from rfpipe.report.text import number, rounded_percent, size
from rfpipe.scenes import RELIGHTING_PATTERNS
from rfpipe.stages import evaluate, relight
from rfpipe.stages.verification import compare_with_captured
from rfpipe.storage.results import write_result
from rfpipe.store import open_arrays, read_manifest, write_arrays, write_manifest
from rfpipe.transport.dense import DenseTransport

pytestmark = pytest.mark.usefixtures("quick_fonts")


def built(folder, config):
    """Write the report of a results folder and return the parts of its page."""
    path = folder / "report" / "index.html"
    build_report(config, folder, path, *tables_of(folder))
    return Page(path)


def stems(folder, kind="figures/*.png"):
    return {path.stem for path in (folder / "report").glob(kind)}


@pytest.fixture(scope="module")
def results(tmp_path_factory, quick_fonts):
    folder = tmp_path_factory.mktemp("both") / "results"
    acquired(folder, BOTH)
    benchmarked(folder, BOTH.scenes, BOTH.methods)
    built(folder, BOTH)
    return folder


@pytest.fixture(scope="module")
def page(results):
    return Page(results / "report" / "index.html")


@pytest.fixture(scope="module")
def inputs(results):
    return load_inputs(BOTH, results, *tables_of(results))


def test_figures_are_embedded_and_written_as_files_like_tables(results, page):
    assert stems(results) == {
        "scene_flat", "scene_corner", "leaves", "speed_error",
    }  # fmt: skip
    figures = results / "report" / "figures"
    assert sorted(page.images) == sorted(path.read_bytes() for path in figures.glob("*.png"))
    tables = {"results", "errors", "speed_error", "levels"}
    assert stems(results, "tables/*.csv") == tables
    assert check_page(results / "report" / "index.html") == []


def test_the_page_is_self_contained_and_names_rows_and_columns(page):
    markup = re.sub(r"base64,[^\"]*", "", page.source)
    assert not re.search(r"https?:|//[a-z]|@import|<script|<link", markup)
    assert all(link[1:] in page.anchors for link in page.links if link.startswith("#"))
    assert "Two <small> scenes" in page.words
    assert "<small>" not in page.source
    folded = re.findall(r"<summary>(.*?)</summary>", page.source)
    assert {"Errors by pattern", "Levels"} < set(folded)
    assert "What it took" not in folded
    tables = re.findall(r"<table>.*?</table>", page.source, re.DOTALL)
    assert all('scope="col"' in table and 'scope="row"' in table for table in tables)
    assert all(re.findall(r'<img [^>]*alt="([^"]+)"', page.source))


@pytest.mark.parametrize("width", [1280, 1920])
def test_the_page_fits_a_screen_and_begins_with_the_results(chromium, results, width):
    screen = chromium.new_page(viewport={"width": width, "height": 1000})
    screen.goto(f"file://{results}/report/index.html")
    assert screen.evaluate("document.documentElement.scrollWidth") <= width
    assert screen.evaluate(
        "[...document.querySelectorAll('.scroll')].every(it => it.scrollWidth <= it.clientWidth)"
    )
    table, picture = (screen.locator(it).first.bounding_box() for it in ("table", "img"))
    assert table["y"] + table["height"] < picture["y"] < 700
    assert picture["width"] > 800
    screen.close()


def test_verification_pictures_and_the_rig_are_shown(tmp_path):
    verification = VerificationConfig(pictures=3, fail_above=1e-6)
    config = GREY.model_copy(update={"verification": verification})
    acquired(tmp_path, config)
    folder = tmp_path / "grey/brute_force"
    image = np.ones((3, 5, 6, 1), np.float32)
    light = image, 0.01 * image
    result = compare_with_captured(
        image[..., 0], light, 1.1 * image, np.ones(1), (image[0], image[0])
    )
    rig = {
        "drift": 0.004, "moved": 0.3,
        "alarms": ["level 2: the rig or the scene moved"], "saturated": 7, "samples": 700,
    }  # fmt: skip
    arrays = {"captured": result.captured, "relit": result.relit}
    write_result(folder / "verification.json", "it", arrays, {**result.facts(), **rig})
    page = built(tmp_path, config)
    assert "NOTICED DURING THE CAPTURE, level 2: the rig or the scene moved" in page.words
    assert "3 relit pictures" in page.words
    assert (
        f"ABOVE THE ACCEPTED ERROR: verified {rounded_percent(result.mean_error)} %" in page.words
    )
    assert page.source.count('<p class="alarm">') == 2
    assert page.source.count('<tr class="alarm">') == 1
    report = json.loads((tmp_path / "report/results.json").read_text())
    (entry,) = report["provenance"]["acquisitions"]
    assert entry["verification"]["mean_error"] == pytest.approx(result.mean_error)
    assert "verified_grey_brute_force_spots_1_relit" in stems(tmp_path, "figures/*.exr")
    (row,) = pd.read_csv(tmp_path / "report/tables/verification.csv").to_dict("records")
    assert (row["drift"], row["moved"]) == (0.004, 0.3)
    pictures = pd.read_csv(tmp_path / "report/tables/pictures.csv")
    assert (pictures["plain_error"] >= pictures["error"] * 0.999).all()


@pytest.mark.slow
def test_the_same_results_give_the_same_bytes(results, tmp_path):
    copy = tmp_path / "results"
    shutil.copytree(results, copy)
    built(copy, BOTH)
    written = [path for path in (results / "report").rglob("*") if path.is_file()]
    kinds = {".html", ".json", ".png", ".pdf", ".exr", ".csv", ".tex"}
    assert {path.suffix for path in written} == kinds
    for path in written:
        assert path.read_bytes() == (copy / path.relative_to(results)).read_bytes(), path.name


def test_costs_count_patterns_bytes_and_seconds(results, inputs):
    rows = [result_of(inputs, run) for run in inputs.runs]
    assert [(row["scene"], row["method"]) for row in rows] == BOTH.acquisitions
    assert all(row["rays"] == 80 for row in rows)
    assert all((row["pictures"], row["frames"]) == (40, 160) for row in rows)
    assert all(row["capture_s"] == 2 * 40 for row in rows)  # of all pictures, including references
    # eight processing jobs in two levels, and the assembly; captures are not processing
    assert all(row["processing_s"] == 9 for row in rows)
    stored = (results / "corner" / "dual" / "transport.zarr").rglob("*")
    nbytes = sum(path.stat().st_size for path in stored if path.is_file())
    assert rows[3]["megabytes"] == pytest.approx(nbytes / 1e6)


def test_a_summary_has_the_origin_of_the_report(results):
    result = json.loads((results / "report" / "results.json").read_text("utf-8"))["provenance"]
    assert (result["seed"], result["versions"]) == (BOTH.seed, versions())
    assert result["configuration"] == BOTH.result_settings()
    assert result["configuration_fingerprint"] == fingerprint(BOTH.result_settings())
    for it in result["acquisitions"]:
        folder = results / it["scene"] / it["method"]
        assert it["transport_digest"] == read_manifest(folder / "transport.json")["digest"]
        assert it["relit_digest"] == open_arrays(folder / "relight.zarr").digest
        assert it["patterns"] == read_manifest(folder / "transport.json")["patterns"]
        assert it["pictures"] == 40


def test_pictures_are_written_as_linear_radiance(results, page):
    assert stems(results, "figures/*.exr") == {
        f"scene_{scene}_{name}"
        for scene in ("flat", "corner")
        for name in ("floodlit", "relit_symmetric", "relit_dual", "truth")
    }
    images = open_arrays(results / "corner" / "symmetric" / "relight.zarr")
    for name, kept_as in (("relit", "relit_symmetric"), ("truth", "truth")):
        # linear, and not brightened
        written_image = read_image(results / f"report/figures/scene_corner_{kept_as}.exr")
        index = list(RELIGHTING_PATTERNS).index("horizontal_bar")
        np.testing.assert_array_equal(written_image, images.read(name)[index])
    assert "White is radiance" in page.words


def image_of_one_colour(path: Path) -> None:
    assert oiio.ImageBuf(oiio.ImageSpec(8, 6, 3, oiio.UINT8)).write(str(path))


@pytest.mark.parametrize(
    ("name", "damage", "message"),
    [
        ("figures/leaves.png", image_of_one_colour, "leaves.png: blank"),
        ("tables/errors.csv", Path.unlink, "links to tables/errors.csv, which is missing"),
        ("index.html", lambda it: it.write_text(""), "has no picture"),
    ],
)
def test_faults_of_a_page_are_listed(results, tmp_path, name, damage, message):
    shutil.copytree(results / "report", tmp_path / "report")
    damage(tmp_path / "report" / name)
    assert any(message in fault for fault in check_page(tmp_path / "report/index.html"))


@pytest.mark.slow
def test_the_thesis_figures_of_planes_are_drawn_from_a_run(results, tmp_path, monkeypatch):
    monkeypatch.chdir(results.parent)
    run_script("planes", tmp_path, Size())
    assert {path.stem for path in tmp_path.glob("*.png")} == {
        "fig_2_1_symmetric", "fig_2_1_dual", "fig_5_7_symmetric", "fig_5_7_dual", "fig_5_9_corner",
    }  # fmt: skip


def test_one_channel_one_method_and_no_camera(tmp_path):
    acquired(tmp_path, GREY)
    view = tmp_path / "report" / "view" / "grey_brute_force.html"
    view.parent.mkdir()
    view.write_text("a page to light the scene on", "utf-8")
    page = built(tmp_path, GREY)
    assert "view/grey_brute_force.html" in page.links
    assert stems(tmp_path) == {"scene_grey", "speed_error"}


@pytest.mark.slow
def test_a_light_field_shows_its_middle_view(tmp_path):
    acquired(tmp_path, FIELD)
    page = built(tmp_path, FIELD)
    assert stems(tmp_path) == {"scene_corner", "scene_field", "leaves", "speed_error"}
    assert f"corner, {size(8, 10)} rays; field, {size(2, 3, 6, 9)} rays" in page.words
    inputs = load_inputs(FIELD, tmp_path, *tables_of(tmp_path))
    (field,) = inputs.of_scene("field")
    assert field.rays == 2 * 3 * 6 * 9
    assert field.middle(np.arange(6).reshape(6, 1, 1, 1)).item() == 4


def test_the_report_begins_with_a_table_and_each_scene_with_its_truth(results, inputs):
    first, second = make_sections(inputs)[:2]
    assert (first.anchor, second.anchor) == ("glance", "speed")
    table, gallery, purposes = first.blocks
    assert purposes.name == "Pictures on the rig"
    counts = dict(zip(purposes.columns, purposes.rows[0], strict=True))
    assert (counts["pictures on the rig"], counts["exposures"]) == ("40", "160")
    assert [figure.name for figure in gallery.figures] == ["flat", "corner"]
    pictures = ["floodlit", *(name.replace("_", " ") for name in RELIGHTING_PATTERNS)]
    for figure in gallery.figures:
        assert list(figure.light) == ["floodlit", "truth", "relit_symmetric", "relit_dual"]
        panels = figure.figure.axes[:30]
        assert [axis.get_title() for axis in panels[:6]] == pictures
        rows = [axis.get_ylabel().replace("\n", " ") for axis in panels[::6]]
        methods = ["Symmetric photography", "Dual photography"]
        assert rows == ["truth", methods[0], "difference", methods[1], "difference"]
        for first, method in ((6, "symmetric"), (18, "dual")):
            table_errors = inputs.errors.set_index(["scene", "method", "pattern"])["error"]
            expected = [table_errors.loc[figure.name, method, name] for name in RELIGHTING_PATTERNS]
            shown = [axis.get_xlabel().partition("\n")[0] for axis in panels[first + 1 : first + 6]]
            assert shown == [f"error {rounded_percent(error)} %" for error in expected]
    errors = inputs.errors.set_index(["pattern", "scene", "method"])["error"]
    written = pd.read_csv(results / "report" / "tables" / "results.csv")
    for row, shown in zip(written.to_dict("records"), table.rows, strict=True):
        of_kinds = [errors.loc[kind, row["scene"], row["method"]] for kind in KINDS]
        assert row["mean_error"] == pytest.approx(np.mean(of_kinds), rel=1e-4)
        assert row["worst_error"] > row["mean_error"]
        assert row["mean_indirect"] == 0 if row["scene"] == "flat" else row["mean_indirect"] > 0
        assert row["minutes"] == pytest.approx((2 * row["pictures"] + 9) / 60, rel=1e-4)
        assert shown[2] == number(row["patterns"])
        assert shown[table.columns.index("error, %")] == rounded_percent(row["mean_error"])
        indirect = shown[table.columns.index("error of indirect light, %")]
        assert (indirect == "none") == (row["scene"] == "flat")
    assert "error of indirect light, %" in table.columns
    assert not any(column.startswith("indirect") for column in table.columns)
    assert "exact truth" in table.caption


class Aside:
    """A scene with a displaced camera of 5 x 6 rays and a projector of 4 x 8 rays."""

    camera_shape, projector_shape = (5, 6), (4, 8)
    channels = 1
    albedo = np.full((5, 6, 1), 0.5, np.float32)
    matrix = np.random.default_rng(0).random((30, 32)).astype(np.float32)

    def apply(self, patterns):
        return (patterns.reshape(len(patterns), 32) @ self.matrix.T)[..., None]


def captured(folder, arrays, result=None):
    """Write the results of the relight stage for a rig that isn't coaxial."""
    (folder / "desk/dual").mkdir(parents=True)
    write_arrays(folder / "desk/dual/relight.zarr", arrays, {})
    level = {"level": 0, "patterns": 12, "nodes": 30, "empty": 0, "rank1": 9, "scalar": 21,
             "subdivided": 0}  # fmt: skip
    facts = {"scene": "desk", "method": "dual", "names": list(RELIGHTING_PATTERNS), "row": 2,
             "coaxial": False, "options": {}, "patterns": 12, "bytes": 4000,
             "levels": [level, {**level, "level": 1, "patterns": 0, "nodes": 0}],
             **(result or {})}  # fmt: skip
    write_manifest(folder / "desk/dual/relight.json", facts)
    evaluate.run([folder / "desk/dual/relight.json"], *tables_of(folder), 2.0)


ASIDE = Config.model_validate(
    {
        "scenes": {"desk": {"kind": "captured", "shape": [4, 8],
                            "camera_shape": [5, 6], "channels": 1}},
        "methods": {"dual": {}},
        "capture": {"rig": "remote"},
    }
)  # fmt: skip


def glance_of(folder):
    return make_sections(load_inputs(ASIDE, folder, *tables_of(folder)))[0].blocks


def aside_transport():
    return DenseTransport((5, 6), (4, 8), 1, [], {"matrix": Aside.matrix[None] * 1.01})


def test_a_rig_that_is_not_coaxial_has_pictures_and_no_unlit_pixels(tmp_path):
    arrays = relight.relit_arrays(aside_transport(), Aside())
    assert arrays["relit"].shape == (5, 5, 6, 1)
    assert arrays["patterns"].shape == (5, 4, 8)
    assert arrays["line_truth"].shape == (6, 8, 1)
    np.testing.assert_allclose(arrays["line_truth"][..., 0], Aside.matrix[12:18, 16:24])
    truth = arrays["floodlit_truth"]
    result = relight.mean_errors(aside_transport(), Aside(), truth, is_coaxial=False)
    assert "mean_indirect" not in result
    grain = {"whole": 0.003, "unlit": 0.052}
    result["recorded"] = {"grain": grain, "versions": {"drjit": "1.5.0"}}
    choice = {"setting": "caustics", "value": True, "reason": "by ball (SmoothDielectric)"}
    light = {"choices": [choice], "omissions": ["light that ball throws is missing"]}
    captured(tmp_path, arrays, {**result, "light": light})
    errors = pd.read_csv(tables_of(tmp_path)[0])
    # smaller for a picture whose lit pixels reflect little
    assert errors["error"].between(0.005, 0.01001).all()
    assert errors["error"].max() == pytest.approx(0.01, rel=1e-3)
    assert errors["indirect_error"].isna().all()
    page = built(tmp_path, ASIDE)
    assert "times brighter" not in page.words
    assert "scene_desk" in stems(tmp_path)
    table = glance_of(tmp_path)[0]
    assert "indirect" not in table.caption  # no pixel is known to be unlit
    assert "recording" in table.rows[0]
    assert "desk 0.30 % (5.20 % on unlit pixels)" in table.caption
    assert "drjit 1.5.0" in page.words.replace("  ", " ")
    # choices of the scene and omitted light
    assert "desk: light that ball throws is missing." in page.words
    for cell in ("caustics", "true", choice["reason"]):
        assert f" {cell} " in page.words
    summary = json.loads((tmp_path / "report" / "results.json").read_text())
    assert summary["provenance"]["acquisitions"][0]["light"] == light


def test_a_scene_without_truth_is_shown_without_error(tmp_path):
    floodlit = Aside.matrix.sum(1).reshape(5, 6, 1)
    captured(tmp_path, relight.relit_of_captured(aside_transport(), floodlit))
    page = built(tmp_path, ASIDE)
    (table, gallery) = glance_of(tmp_path)
    patterns = [f"{name}_dual" for name in RELIGHTING_PATTERNS]
    assert list(gallery.figures[0].light) == ["floodlit", *patterns]
    assert {"12", "not verified"} < set(table.rows[0])
    assert "error, %" not in table.columns
    assert "the true light transport of a real scene is unknown" in page.words
    # levels without patterns are omitted
    assert pd.read_csv(tmp_path / "report/tables/levels.csv")["level"].tolist() == [0]


def test_without_anything_relit_there_is_no_report(tmp_path):
    for table in tables_of(tmp_path):
        table.parent.mkdir(parents=True, exist_ok=True)
        table.write_text("scene,method\n")
    with pytest.raises(StoreError, match="no relit acquisition of the scenes grey"):
        built(tmp_path, GREY)


def test_panels_show_light_and_errors_signed_on_one_round_scale():
    image = np.random.default_rng(0).random((5, 7, 3)).astype(np.float32)
    truth, gain = Panel(image, "truth", white=2.0), np.where(np.arange(35) % 2, 4.0, 1.0)
    relit = Panel(image + np.float32(0.1), "relit", "error 10 %", 2.0, gain.reshape(5, 7))
    np.testing.assert_allclose(relit.less(truth).values, 5 * gain.reshape(5, 7), rtol=1e-4)
    lower = difference(0.9 * image, image, 2.0)
    figure = draw([[relit, truth, relit.less(truth)], [None, None, lower]])
    shown = [axis for axis in figure.axes if axis.get_title() == "error"]
    assert [axis.images[0].get_clim() for axis in shown] == [(-20, 20)] * 2  # per cent of white
    assert figure.axes[0].get_xlabel() == "error 10 %"
    np.testing.assert_allclose(figure.axes[1].images[0].get_array(), srgb(image, 2.0))
    assert Panel(image[..., 0]).drawn.values.shape == (5, 7, 3)
    assert len(draw([[truth]]).axes) == 1
