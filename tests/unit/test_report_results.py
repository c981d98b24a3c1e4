"""What a report leaves for machines: numbers and linear light; the check that none is blank."""

import json
import re
import shutil
from pathlib import Path

import colour
import numpy as np
import OpenImageIO as oiio
import pandas as pd
import pytest
from jsonschema import Draft202012Validator
from matplotlib.figure import Figure
from tests.reports import BOTH, Page, acquired, benchmarked, tables_of

from rfpipe.errors import InputError, StoreError
from rfpipe.pictures.images import srgb
from rfpipe.provenance import fingerprint, versions
from rfpipe.report import build_report, check_report
from rfpipe.report.blocks import Illustration, Section
from rfpipe.report.drawing import Drawing, new_panels
from rfpipe.report.drawn import panels_of
from rfpipe.report.entries import SCHEMA_NAME, TableEntry, read_results, results_schema
from rfpipe.report.light import Light, error_map, read_exr, round_limit, write_exr
from rfpipe.report.placing import Place
from rfpipe.store import open_arrays, read_manifest
from rfpipe.store.files import digest_of

pytestmark = pytest.mark.slow

DOCS = Path(__file__).parents[2] / "docs"
RANDOM = np.random.default_rng(0)
IMAGE = RANDOM.random((5, 7, 3)).astype(np.float32)


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    folder = tmp_path_factory.mktemp("results") / "results"
    acquired(folder, BOTH)
    benchmarked(folder, BOTH.scenes, BOTH.methods)
    build_report(BOTH, folder, folder / "report" / "index.html", *tables_of(folder))
    return folder


@pytest.fixture
def report(built, tmp_path):
    """A report to damage."""
    shutil.copytree(built / "report", tmp_path / "report")
    return tmp_path / "report"


def test_the_stored_schema_is_the_models():
    stored = json.loads((DOCS / SCHEMA_NAME).read_text(encoding="utf-8"))
    assert stored == results_schema(), "run 'make config'"


def test_a_report_fits_the_schema_and_is_whole(built):
    data = json.loads((built / "report" / "results.json").read_text(encoding="utf-8"))
    Draft202012Validator(results_schema()).validate(data)
    results = check_report(built / "report")
    assert len(results.figures) == len(list((built / "report" / "figures").glob("*.png")))
    data["sections"][0]["content"][0]["width"] = "wide"
    assert not Draft202012Validator(results_schema()).is_valid(data)


def texts_of(data) -> list[str]:
    """All texts within JSON, without the numbers beside them."""
    if isinstance(data, dict | list):
        inner = data.values() if isinstance(data, dict) else data
        return [text for value in inner for text in texts_of(value)]
    return [data] if isinstance(data, str) else []


def test_every_number_of_the_page_stands_in_its_results(built):
    page = Page(built / "report" / "index.html")
    data = json.loads((built / "report" / "results.json").read_text(encoding="utf-8"))
    of_number = re.compile(r"\d(?:[\d,.]*\d)?(?:e[+-]\d+)?")
    held = set(of_number.findall(" ".join(texts_of(data))))
    shown = set(of_number.findall(page.words.rpartition("}")[-1]))  # after the style sheet
    assert len(shown) > 100
    assert shown <= held


def test_tables_have_their_numbers_in_full(built):
    results = read_results(built / "report" / "results.json")
    tables = {
        entry.csv: entry
        for section in results.sections
        for entry in section.content
        if isinstance(entry, TableEntry) and entry.csv
    }
    for name in ("results", "errors", "speed_error", "levels", "costs"):
        written = pd.read_csv(built / "report" / "tables" / f"{name}.csv")
        records = pd.DataFrame(tables[f"tables/{name}.csv"].records)
        assert list(records) == sorted(written)
        for column in written.select_dtypes("number"):
            held = pd.to_numeric(records[column])
            np.testing.assert_allclose(held, written[column], rtol=1e-4)


def test_provenance_names_what_it_was_made_from(built):
    found = read_results(built / "report" / "results.json").provenance
    assert found.seed == BOTH.seed
    assert found.versions == versions()
    assert found.configuration == BOTH.shaping()
    assert found.configuration_fingerprint == fingerprint(BOTH.shaping())
    assert [(it.scene, it.method) for it in found.acquisitions] == BOTH.acquisitions
    for it in found.acquisitions:
        folder = built / it.scene / it.method
        assert it.transport_digest == read_manifest(folder / "transport.json")["digest"]
        assert it.relit_digest == open_arrays(folder / "relight.zarr").digest
        assert it.capture_s == 2 * it.patterns
        assert it.scene_settings["bounces"] == 3
        # two levels' captures; eight other stages and the assembly
        assert (it.capture_jobs_s, it.processing_s) == (2, 9)
    for source in found.sources:
        assert source.digest == digest_of((built / source.file).read_bytes())


def test_figures_say_what_they_are_of(built):
    results = read_results(built / "report" / "results.json")
    figures = {Path(figure.png).stem: figure for figure in results.figures}
    assert all(figure.sources for figure in figures.values())
    for slug, name in {
        "fig_2_1_dual": "Fig. 2.1", "fig_5_7": "Fig. 5.7", "fig_5_9": "Fig. 5.9",
        "fig_5_10": "Fig. 5.10", "fig_3_8": "Fig. 3.8", "fig_b_1": "Fig. B.1",
    }.items():  # fmt: skip
        assert figures[slug].thesis.name == name
    assert figures["speed_error"].thesis is None
    with_light = {slug for slug, figure in figures.items() if figure.exr}
    assert with_light == {
        "scene_flat", "scene_corner", "fig_2_1_symmetric", "fig_2_1_dual", "fig_5_7", "fig_5_9",
        "fig_b_1",
    }  # fmt: skip
    for slug in with_light:
        figure = figures[slug]
        assert "Exposure: white is " in figure.caption
        for it in figure.exposures:
            assert re.search(rf"{it.quantity} .*\b{it.white:.3g}[ ,;]", figure.caption)
        assert figure.exr_digest == digest_of((built / "report" / figure.exr).read_bytes())
    scene = figures["scene_corner"]
    assert "Error: relit minus truth, by the scale at the right" in scene.caption
    relight = read_manifest(built / "corner" / "symmetric" / "relight.json")
    images = open_arrays(built / "corner" / "symmetric" / "relight.zarr")
    index = relight["names"].index("horizontal_bar")
    parts = read_exr(built / "report" / scene.exr)
    np.testing.assert_array_equal(parts["corner, relit"], images.read("relit")[index])
    np.testing.assert_array_equal(parts["corner, truth"], images.read("truth")[index])
    assert {it.white for it in scene.exposures} == {float(images.read("floodlit_truth").max())}
    assert max(it.brightened for it in scene.exposures) == 4


def blank(path: Path) -> None:
    picture = oiio.ImageBuf(oiio.ImageSpec(8, 6, 3, oiio.UINT8))
    assert picture.write(str(path))


def flat(path: Path) -> None:
    names = list(read_exr(path))
    grey = [Light(*name.split(", ", 1), np.ones((4, 4, 3), np.float32), 1.0) for name in names]
    write_exr(path, grey)


def without_curves(path: Path) -> None:
    data = json.loads(path.read_text(encoding="utf-8"))
    for section in data["sections"]:
        for entry in section["content"]:
            if entry.get("png") == "figures/fig_5_10.png":
                for panel in entry["panels"]:
                    panel["bars"] = []
    path.write_text(json.dumps(data), encoding="utf-8")


@pytest.mark.parametrize(
    ("name", "damage", "said"),
    [
        ("figures/fig_3_8.png", Path.unlink, "figures/fig_3_8.png: missing"),
        ("figures/fig_3_8.png", blank, "figures/fig_3_8.png: blank, all pixels"),
        ("figures/fig_5_7.exr", Path.unlink, "links figures/fig_5_7.exr, which is missing"),
        ("figures/scene_flat.exr", flat, "figures/scene_flat.exr: blank, each picture"),
        ("tables/errors.csv", Path.unlink, "links tables/errors.csv, which is missing"),
        ("index.html", Path.unlink, "index.html: missing"),
        ("index.html", lambda it: it.write_text(""), "index.html: shows 0 figures; expected"),
        ("results.json", Path.unlink, "results.json: can't be read as a report's numbers"),
        ("results.json", without_curves, "figures/fig_5_10.png: blank, nothing is drawn"),
    ],
)  # fmt: skip
def test_the_check_finds_what_is_missing_or_blank(report, name, damage, said):
    check_report(report)
    damage(report / name)
    with pytest.raises(StoreError, match=re.escape(said)):
        check_report(report)


def test_tones_are_those_of_the_standard():
    """The report's are colour-science's, which takes seconds to load; elsewhere stands a curve."""
    linear = np.clip(IMAGE / 0.7, 0, 1)
    expected = colour.cctf_encoding(linear, function="sRGB")
    np.testing.assert_allclose(srgb(IMAGE, 0.7), expected, rtol=1e-6)
    grey = Light("scene", "grey", IMAGE[..., :1], 1.0)
    np.testing.assert_allclose(grey.shown, srgb(IMAGE[..., :1], 1.0), rtol=1e-6)
    assert grey.shown.shape == (5, 7, 3)


def test_light_keeps_its_parts_channels_and_shapes(tmp_path):
    grey = Light("a", "grey", RANDOM.random((3, 4, 1)).astype(np.float32), 2.0)
    colours = Light("b", "relit", IMAGE - 0.5, 1.5, gain=4.0)
    write_exr(tmp_path / "x.exr", [grey, colours, grey])
    parts = read_exr(tmp_path / "x.exr")
    assert list(parts) == ["a, grey", "b, relit"]
    np.testing.assert_array_equal(parts["a, grey"], grey.radiance)
    np.testing.assert_array_equal(parts["b, relit"], colours.radiance)  # linear, not brightened
    other = Light("b", "relit", IMAGE, 1.5)
    with pytest.raises(InputError, match="different pictures of light called 'b, relit'"):
        write_exr(tmp_path / "x.exr", [colours, other])


def test_channels_are_found_by_name(tmp_path):
    spec = oiio.ImageSpec(7, 5, 3, oiio.FLOAT)
    spec.channelnames = ("B", "G", "R")
    output = oiio.ImageOutput.create("x.exr")
    assert output.open(str(tmp_path / "x.exr"), spec)
    assert output.write_image(np.ascontiguousarray(IMAGE[..., ::-1]))
    assert output.close()
    (read,) = read_exr(tmp_path / "x.exr").values()
    np.testing.assert_array_equal(read, IMAGE)


def test_an_error_map_is_signed_and_brightened_as_its_picture():
    truth = Light("a", "truth", IMAGE, 2.0)
    gain = np.where(np.arange(35).reshape(5, 7) % 2, 4.0, 1.0)
    relit = Light("a", "relit", IMAGE + np.float32(0.1), 2.0, gain)
    np.testing.assert_allclose(error_map(relit, truth), 0.05 * gain, rtol=1e-5)
    assert round_limit([np.linspace(-0.013, 0.013, 101)]) == pytest.approx(0.02)
    assert round_limit([np.zeros(4)]) == pytest.approx(1e-5)


def test_the_one_way_to_add_a_figure(tmp_path):
    (tmp_path / "made_from.json").write_text("{}")
    drawing = new_panels(1, 3, [(5, 7)], 2.0, 0.3)
    relit, truth = (Light("bottle", what, IMAGE * part, 1.0)
                    for what, part in (("relit", 0.9), ("truth", 1.0)))  # fmt: skip
    first, second, third = drawing.axes[0]
    drawing.show(first, relit, "error 10 %")
    drawing.show(second, truth)
    drawing.compare(third, relit, truth)
    drawing.show_errors()
    block = Illustration(
        "Fig. 3.6", "A bottle.", "fig_3_6", drawing, "Fig. 3.6", ["made_from.json"]
    )
    (entry,) = Place(tmp_path, tmp_path).put(Section("bottle", "A bottle", [block])).entry.content
    assert (entry.png, entry.exr) == ("figures/fig_3_6.png", "figures/fig_3_6.exr")
    assert set(read_exr(tmp_path / entry.exr)) == {"bottle, relit", "bottle, truth"}
    assert entry.caption == "A bottle. Exposure: white is radiance 1; sRGB tones."
    assert "caustics" in entry.thesis.claim
    assert entry.panels[0].x_label == "error 10 %"
    low, high = entry.panels[2].image
    assert (low, high) == (-10, 10)  # per cent of white
    assert entry.sources[0].digest == digest_of(b"{}")


def test_a_charts_data_are_read_back():
    figure = Figure()
    axis = figure.subplots()
    axis.plot([1, 2, 3], [4.0, np.nan, np.inf], label="curve")
    axis.axvline(7, label="limit")
    axis.bar([0, 1], [2, 3], 0.5, label="bars")
    axis.fill_between([0, 1], [0, 0], [1, 2], label="band")
    axis.set(title="t", xlabel="x", yscale="log")
    (panel,) = panels_of(figure)
    curve, limit = panel.curves
    assert (curve.label, curve.x, curve.y) == ("curve", [1, 2, 3], [4.0, None, "inf"])
    assert (limit.label, limit.x, limit.y) == ("limit", [7], [])
    assert (panel.bars[0].height, panel.bars[0].width) == ([2, 3], [0.5, 0.5])
    assert max(panel.areas[0].y) == 2
    assert (panel.title, panel.x_label, panel.y_scale) == ("t", "x", "log")


def test_a_drawing_without_errors_has_no_scale():
    figure = Figure()
    drawing = Drawing(figure, figure.subplots(1, 1, squeeze=False))
    drawing.show_errors()
    assert len(drawing.figure.axes) == 1
