"""The report of small results folders: everything that exists is shown, and nothing else."""

import dataclasses
import json
import re
import shutil

import numpy as np
import pandas as pd
import pytest
from tests.reports import (
    BOTH,
    FIELD,
    GREY,
    Page,
    acquired,
    benchmarked,
    tables_of,
)

from rfpipe.config import Config
from rfpipe.config.capture import VerificationConfig
from rfpipe.errors import InputError, StoreError
from rfpipe.pictures.images import srgb
from rfpipe.report import build_report
from rfpipe.report.glance import results as results_of
from rfpipe.report.inputs import load_inputs
from rfpipe.report.leaves import leaves_section
from rfpipe.report.page import make_sections
from rfpipe.report.pictures import amplification, levels_section
from rfpipe.report.text import number, percent, size
from rfpipe.scenes import RELIGHTING_PATTERNS
from rfpipe.stages import relight
from rfpipe.stages.evaluating import evaluate
from rfpipe.stages.folder import write_bundle
from rfpipe.stages.verification import compare
from rfpipe.store import open_arrays, write_arrays, write_manifest
from rfpipe.transport.dense import DenseTransport


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    folder = tmp_path_factory.mktemp("both") / "results"
    acquired(folder, BOTH)
    benchmarked(folder, BOTH.scenes, BOTH.methods)
    build_report(BOTH, folder, folder / "report" / "index.html", *tables_of(folder))
    return folder


@pytest.fixture(scope="module")
def page(results):
    return Page(results / "report" / "index.html")


def test_every_figure_is_embedded_and_lies_beside_the_page(results, page):
    figures = results / "report" / "figures"
    names = {path.stem for path in figures.glob("*.png")}
    assert names == {
        "scene_flat", "scene_corner",
        "fig_2_1_symmetric", "fig_2_1_dual", "fig_5_9", "fig_5_7", "fig_5_10", "speed_error",
        "processing_time",
    }  # fmt: skip
    assert sorted(page.images) == sorted(path.read_bytes() for path in figures.glob("*.png"))
    assert all(image.startswith(b"\x89PNG") for image in page.images)
    assert len(set(page.images)) == len(names)


def test_every_table_lies_beside_the_page(results):
    names = {path.name for path in (results / "report" / "tables").glob("*.csv")}
    assert names == {
        "results.csv", "errors.csv", "speed_error.csv", "levels.csv",
        "processing.csv",
    }  # fmt: skip


def test_the_page_needs_nothing_from_elsewhere(results, page):
    markup = re.sub(r"base64,[^\"]*", "", page.source)
    assert not re.search(r"https?:|//[a-z]|@import|<script|<link", markup)
    for link in page.links:
        if link.startswith("#"):
            assert link[1:] in page.anchors
        else:
            assert (results / "report" / link).is_file()


def test_the_page_names_the_thesis_figures(page):
    for name in ("Fig. 2.1", "Fig. 5.7", "Fig. 5.9", "Fig. 5.10", "Speed against error"):
        assert name in page.words


def test_what_verified_a_run_is_shown_beside_the_rig(tmp_path):
    config = GREY.model_copy(update={"verification": VerificationConfig(pictures=3)})
    acquired(tmp_path, config)
    folder = tmp_path / "grey/brute_force"
    image = np.ones((3, 5, 6, 1), np.float32)
    names = ("natural", "stripes", "steep")
    found = compare(names, image[..., 0], (image, 0.01 * image), 1.1 * image, np.ones(1))
    rig = {
        "drift": 0.004, "moved": 0.3, "reciprocity": None, "reciprocity_deviations": None,
        "alarms": ["level 2: the rig or the scene moved"], "saturated": 7, "samples": 700,
        "devices": {"camera failed": 2, "camera frames": 90, "camera reconnected": 1},
    }  # fmt: skip
    arrays = {"captured": found.captured, "relit": found.relit}
    write_bundle(folder / "verification.json", "it", arrays, {**found.facts(), **rig})
    path = tmp_path / "report/index.html"
    build_report(config, tmp_path, path, *tables_of(tmp_path))
    words = Page(path).words
    assert "NOTICED DURING THE CAPTURE, level 2: the rig or the scene moved" in words
    (entry,) = json.loads(path.with_name("results.json").read_text())["provenance"]["acquisitions"]
    assert entry["verification"]["mean_error"] == pytest.approx(found.mean_error)
    assert (path.parent / "figures/verified_grey_brute_force_steep.png").exists()
    rows = (path.parent / "tables/verification_rig.csv").read_text()
    assert "2,1" in rows.replace(".0", "")


def test_the_title_is_text_and_not_markup(page):
    assert "Two <small> scenes" in page.words
    assert "<small>" not in page.source


@pytest.mark.slow
def test_the_same_results_give_the_same_bytes(results, tmp_path):
    again = tmp_path / "results"
    shutil.copytree(results, again)
    build_report(BOTH, again, again / "report" / "index.html", *tables_of(again))
    written = [path for path in (results / "report").rglob("*") if path.is_file()]
    assert {path.suffix for path in written} == {".html", ".json", ".png", ".exr", ".csv"}
    for path in written:
        assert path.read_bytes() == (again / path.relative_to(results)).read_bytes(), path.name


def test_costs_count_patterns_bytes_and_seconds(results):
    inputs = load_inputs(BOTH, results, *tables_of(results))
    rows = results_of(inputs).to_dict("records")
    assert [(row["scene"], row["method"]) for row in rows] == [
        ("flat", "symmetric"), ("flat", "dual"), ("corner", "symmetric"), ("corner", "dual"),
    ]  # fmt: skip
    assert all(row["rays"] == 80 for row in rows)
    assert all(row["capture_s"] == 2 * row["patterns"] for row in rows)
    # eight processing jobs in two levels, and the assembly; captures are not processing
    assert all(row["processing_s"] == 9 for row in rows)
    stored = (results / "corner" / "dual" / "transport.zarr").rglob("*")
    nbytes = sum(path.stat().st_size for path in stored if path.is_file())
    assert rows[3]["megabytes"] == pytest.approx(nbytes / 1e6)


def test_indirect_light_is_amplified_by_a_round_factor(results):
    inputs = load_inputs(BOTH, results, *tables_of(results))
    flat, corner = inputs.of_method("symmetric")
    assert not flat.has_indirect_light
    assert corner.has_indirect_light
    gain = amplification(corner)
    assert gain / 10 ** np.floor(np.log10(gain)) in (1, 2, 5)
    assert 0.2 < gain * np.percentile(corner.read("half_truth")[:, :5], 99) / corner.white < 0.75


def test_one_channel_one_method_and_no_camera(tmp_path):
    acquired(tmp_path, GREY)
    view = tmp_path / "report" / "view" / "grey_brute_force.html"
    view.parent.mkdir()
    view.write_text("a page to light the scene on", "utf-8")
    build_report(GREY, tmp_path, tmp_path / "report" / "index.html", *tables_of(tmp_path))
    page = Page(tmp_path / "report" / "index.html")
    assert "view/grey_brute_force.html" in page.links
    assert "exact radiance, no noise" in page.words
    for missing in ("Fig. 5.9", "Fig. 5.7", "Fig. 5.10"):
        assert missing not in page.words
    figures = {path.stem for path in (tmp_path / "report" / "figures").glob("*.png")}
    assert figures == {"scene_grey", "fig_2_1_brute_force", "speed_error"}
    assert len(page.images) == 3


def test_methods_that_know_no_earlier_level_are_left_out_of_the_figure_of_levels(results, tmp_path):
    inputs = load_inputs(BOTH, results, *tables_of(results))
    symmetric, dual = (run for run in inputs.runs if run.scene == "corner")
    arrays = {name: dual.read(name) for name in dual.images.names}
    arrays["levels_relit"] = arrays["levels_relit"][-1:]
    write_arrays(tmp_path / "whole.zarr", arrays, {})
    whole = dataclasses.replace(dual, images=open_arrays(tmp_path / "whole.zarr"))
    section = levels_section(dataclasses.replace(inputs, runs=[symmetric, whole]))
    assert len(section.blocks) == 1
    assert levels_section(dataclasses.replace(inputs, runs=[whole])) is None


@pytest.fixture(scope="module")
def with_field(tmp_path_factory):
    folder = tmp_path_factory.mktemp("field") / "results"
    acquired(folder, FIELD)
    benchmarked(folder, ["corner"], ["symmetric"])
    build_report(FIELD, folder, folder / "report" / "index.html", *tables_of(folder))
    return folder


@pytest.mark.slow
def test_a_light_field_has_its_own_pictures_and_leaves_the_others_alone(with_field):
    figures = {path.stem for path in (with_field / "report" / "figures").glob("*.png")}
    assert figures == {
        "scene_corner", "scene_field",
        "fig_2_1_symmetric", "fig_2_1_dual", "fig_5_9", "fig_5_7", "fig_5_10", "speed_error",
        "processing_time",
    }  # fmt: skip
    page = Page(with_field / "report" / "index.html")
    times = "\N{NO-BREAK SPACE}\N{MULTIPLICATION SIGN}\N{NO-BREAK SPACE}"
    assert f"8{times}10 and 2{times}3{times}6{times}9 rays" in page.words
    assert "corner relit with the vertical bar" in page.words  # Fig. 5.7
    assert "37° by 29°" in page.words


def test_levels_of_a_light_field_are_added_up_apart(with_field):
    inputs = load_inputs(FIELD, with_field, *tables_of(with_field))
    (field,) = inputs.light_fields
    assert (field.rays, field.middle_view) == (2 * 3 * 6 * 9, 4)
    assert not field.has_indirect_light
    levels = leaves_section(inputs).blocks[-1].table
    assert {row[0] for row in levels.rows} == {
        "Symmetric photography", "Symmetric photography, light fields", "Dual photography",
    }  # fmt: skip


@pytest.mark.slow
def test_a_light_field_alone_makes_a_report(tmp_path):
    alone = FIELD.model_copy(update={"scenes": {"field": FIELD.scenes["field"]}, "camera": None})
    acquired(tmp_path, alone)
    build_report(alone, tmp_path, tmp_path / "report" / "index.html", *tables_of(tmp_path))
    page = Page(tmp_path / "report" / "index.html")
    assert "the middle view, relit with the vertical bar" in page.words
    figures = {path.stem for path in (tmp_path / "report" / "figures").glob("*.png")}
    assert figures == {
        "scene_field", "fig_5_7", "fig_5_10", "speed_error",
    }  # fmt: skip


def test_it_begins_with_each_scene_beside_truth_and_one_table(results, page):
    inputs = load_inputs(BOTH, results, *tables_of(results))
    first, second = make_sections(inputs)[:2]
    assert (first.anchor, second.anchor) == ("glance", "speed")
    gallery, table = first.blocks
    assert [picture.name for picture in gallery.pictures] == ["flat", "corner"]
    for picture in gallery.pictures:
        assert [light.what for light in picture.light] == ["floodlit", "relit", "truth"]
        assert {light.shown.shape for light in picture.light} == {(8, 10, 3)}
        _, relit, truth = picture.light
        np.testing.assert_allclose(relit.shown, truth.shown, atol=0.1)
        assert picture.compared == (1, 2)
    assert not table.is_folded
    errors = inputs.errors.set_index(["scene", "method"])["rms_total"]
    written = pd.read_csv(results / "report" / "tables" / "results.csv")
    for row, shown in zip(written.to_dict("records"), table.table.rows, strict=True):
        of_run = errors.loc[row["scene"], row["method"]]
        assert row["mean_error"] == pytest.approx(of_run.mean(), rel=1e-4)
        assert row["worst_error"] == pytest.approx(of_run.max(), rel=1e-4)
        assert row["minutes"] == pytest.approx((2 * row["patterns"] + 9) / 60, rel=1e-4)
        assert shown[2] == number(row["patterns"])
        assert shown[6] == percent(row["mean_error"])


def test_long_tables_are_folded_and_every_table_names_rows_and_columns(page):
    folded = re.findall(r"<summary>(.*?)</summary>", page.source)
    for name in ("Errors by pattern", "Error after each level", "Levels"):
        assert name in folded
    assert "What it took" not in folded
    tables = re.findall(r"<table>.*?</table>", page.source, re.DOTALL)
    assert all('scope="col"' in table and "<caption>" in table for table in tables)
    assert all('scope="row' in table for table in tables)
    assert all(re.findall(r'<img [^>]*alt="([^"]+)"', page.source))


class Aside:
    """A scene whose camera of 5 x 6 rays looks aside at what 4 x 8 projector rays light."""

    camera_shape, projector_shape = (5, 6), (4, 8)
    channels = 1
    albedo = np.full((5, 6, 1), 0.5, np.float32)
    matrix = np.random.default_rng(0).random((30, 32)).astype(np.float32)

    def apply(self, patterns):
        return (patterns.reshape(len(patterns), 32) @ self.matrix.T)[..., None]


def captured(method, folder, arrays, scene):
    """Leave what the relight stage does of a scene before a rig that is not coaxial."""
    (folder / scene / method).mkdir(parents=True)
    write_arrays(folder / scene / method / "relight.zarr", arrays, {})
    level = {"level": 0, "patterns": 12, "nodes": 30, "empty": 0, "rank1": 9, "scalar": 21,
             "subdivided": 0}  # fmt: skip
    facts = {"scene": scene, "method": method, "names": list(RELIGHTING_PATTERNS), "row": 2,
             "coaxial": False, "options": {}, "patterns": 12, "bytes": 4000,
             "levels": [level]}  # fmt: skip
    write_manifest(folder / scene / method / "relight.json", facts)
    evaluate.run([folder / scene / method / "relight.json"], *tables_of(folder), 2.0)


ASIDE = Config.model_validate(
    {
        "scenes": {"desk": {"kind": "captured", "shape": [4, 8],
                            "camera_shape": [5, 6], "channels": 1}},
        "methods": {"dual": {}},
        "capture": {"rig": "remote"},
    }
)  # fmt: skip


def aside_transport():
    return DenseTransport((5, 6), (4, 8), 1, [], {"matrix": Aside.matrix[None] * 1.01})


def test_a_camera_that_looks_from_aside_has_pictures_and_no_unlit_pixels(tmp_path):
    arrays = relight.relit_arrays(aside_transport(), Aside())
    assert arrays["relit"].shape == (5, 5, 6, 1)
    assert arrays["patterns"].shape == (5, 4, 8)
    assert arrays["line_truth"].shape == (6, 8, 1)
    np.testing.assert_allclose(arrays["line_truth"][..., 0], Aside.matrix[12:18, 16:24])
    with pytest.raises(InputError, match=r"isn't of a scene from \(4, 8\) to \(5, 6\)"):
        relight.relit_arrays(aside_transport().T, Aside())
    captured("dual", tmp_path, arrays, "desk")
    errors = pd.read_csv(tables_of(tmp_path)[0])
    np.testing.assert_allclose(errors["rms_total"], 0.01, rtol=1e-3)
    assert errors["rms_unlit"].isna().all()
    build_report(ASIDE, tmp_path, tmp_path / "report" / "index.html", *tables_of(tmp_path))
    page = Page(tmp_path / "report" / "index.html")
    assert "times brighter" not in page.words.split("Fig. 2.1")[0]
    assert "Fig. 5.9" not in page.anchors
    assert "Nor is any pixel known to be unlit" in page.words
    assert {"scene_desk", "fig_2_1_dual"} <= {
        path.stem for path in (tmp_path / "report" / "figures").glob("*.png")
    }


def test_a_scene_without_truth_is_shown_without_error(tmp_path):
    arrays = relight.relit_of_captured(aside_transport(), Aside.matrix.sum(1).reshape(5, 6, 1))
    captured("dual", tmp_path, arrays, "desk")
    build_report(ASIDE, tmp_path, tmp_path / "report" / "index.html", *tables_of(tmp_path))
    page = Page(tmp_path / "report" / "index.html")
    (gallery, table) = make_sections(load_inputs(ASIDE, tmp_path, *tables_of(tmp_path)))[0].blocks
    assert [light.what for light in gallery.pictures[0].light] == ["floodlit", "relit"]
    assert gallery.pictures[0].compared is None
    assert table.table.columns[-1] == "stored, MB"
    assert "The truth of a real scene is not known" in page.words


def test_without_anything_relit_there_is_no_report(tmp_path):
    for table in tables_of(tmp_path):
        table.parent.mkdir(parents=True, exist_ok=True)
        table.write_text("scene,method\n")
    with pytest.raises(StoreError, match="no relit acquisition of the scenes grey"):
        build_report(GREY, tmp_path, tmp_path / "report" / "index.html", *tables_of(tmp_path))


def test_srgb_follows_the_standards_curve():
    shown = srgb(np.array([[[0.0], [0.002], [0.5], [2.0], [-1.0]]]), white=1.0)
    assert shown.shape == (1, 5, 3)
    np.testing.assert_allclose(shown[0, :, 1], [0, 12.92 * 0.002, 0.7353570, 1, 0], rtol=1e-5)


def test_numbers_as_text():
    dash = "\N{EN DASH}"
    assert [number(1234.5), number(None), number(float("nan"))] == ["1,234", dash, dash]
    assert [percent(0.01234), percent(0.5), percent(None)] == ["1.23", "50", dash]
    assert size(3, 4) == "3\N{NO-BREAK SPACE}\N{MULTIPLICATION SIGN}\N{NO-BREAK SPACE}4"
