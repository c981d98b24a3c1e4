"""What a report leaves for machines: its origin, and linear light."""

import json
import shutil
from pathlib import Path

import colour
import numpy as np
import OpenImageIO as oiio
import pytest
from matplotlib.figure import Figure
from tests.reports import BOTH, Page, acquired, benchmarked, read_exr, tables_of

from rfpipe.pictures.images import srgb
from rfpipe.provenance import fingerprint, versions
from rfpipe.report import build_report, check_page
from rfpipe.report.blocks import Illustration, Section
from rfpipe.report.drawing import Drawing, new_panels
from rfpipe.report.light import Light, error_map, round_limit, write_exr
from rfpipe.report.placing import place
from rfpipe.store import open_arrays, read_manifest

pytestmark = pytest.mark.slow

RANDOM = np.random.default_rng(0)
IMAGE = RANDOM.random((5, 7, 3)).astype(np.float32)


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    folder = tmp_path_factory.mktemp("results") / "results"
    acquired(folder, BOTH)
    benchmarked(folder, BOTH.scenes, BOTH.methods)
    build_report(BOTH, folder, folder / "report" / "index.html", *tables_of(folder))
    return folder


def test_a_summary_names_what_the_report_was_made_from(built):
    found = json.loads((built / "report" / "results.json").read_text(encoding="utf-8"))
    found = found["provenance"]
    assert found["seed"] == BOTH.seed
    assert found["versions"] == versions()
    assert found["configuration"] == BOTH.shaping()
    assert found["configuration_fingerprint"] == fingerprint(BOTH.shaping())
    each = found["acquisitions"]
    assert [(it["scene"], it["method"]) for it in each] == BOTH.acquisitions
    for it in each:
        folder = built / it["scene"] / it["method"]
        assert it["transport_digest"] == read_manifest(folder / "transport.json")["digest"]
        assert it["relit_digest"] == open_arrays(folder / "relight.zarr").digest
        assert it["capture_s"] == 2 * it["patterns"]
        # two levels' captures; eight other stages and the assembly
        assert (it["capture_jobs_s"], it["processing_s"]) == (2, 9)


def test_pictures_of_light_lie_beside_the_page_as_they_are(built):
    figures = built / "report" / "figures"
    assert {path.stem for path in figures.glob("*.exr")} == {
        "scene_flat", "scene_corner",
    }  # fmt: skip
    assert {path.stem for path in figures.glob("*.exr")} < {
        path.stem for path in figures.glob("*.png")
    }
    words = Page(built / "report" / "index.html").words
    assert words.count("Exposure: white is ") == 6
    assert "Error: relit minus truth, by the scale at the right" in words
    relight = read_manifest(built / "corner" / "symmetric" / "relight.json")
    images = open_arrays(built / "corner" / "symmetric" / "relight.zarr")
    index = relight["names"].index("horizontal_bar")
    parts = read_exr(figures / "scene_corner.exr")
    np.testing.assert_array_equal(parts["corner, relit"], images.read("relit")[index])
    np.testing.assert_array_equal(parts["corner, truth"], images.read("truth")[index])


def image_of_one_colour(path: Path) -> None:
    assert oiio.ImageBuf(oiio.ImageSpec(8, 6, 3, oiio.UINT8)).write(str(path))


@pytest.mark.parametrize(
    ("name", "damage", "said"),
    [
        ("figures/fig_5_10.png", image_of_one_colour, "fig_5_10.png: blank"),
        ("tables/errors.csv", Path.unlink, "links tables/errors.csv, which is missing"),
        ("index.html", lambda it: it.write_text(""), "shows no picture"),
    ],
)
def test_a_page_s_faults_are_told(built, tmp_path, name, damage, said):
    shutil.copytree(built / "report", tmp_path / "report")
    page = tmp_path / "report/index.html"
    assert check_page(page) == []
    damage(tmp_path / "report" / name)
    assert any(said in fault for fault in check_page(page))


def test_tones_are_those_of_the_standard():
    expected = colour.cctf_encoding(np.clip(IMAGE / 0.7, 0, 1), function="sRGB")
    np.testing.assert_allclose(srgb(IMAGE, 0.7), expected, rtol=1e-6)
    grey = Light("scene", "grey", IMAGE[..., :1], 1.0)
    assert grey.shown.shape == (5, 7, 3)


def test_light_keeps_its_parts_and_channels(tmp_path):
    grey = Light("a", "grey", RANDOM.random((5, 7, 1)).astype(np.float32), 2.0)
    colours = Light("b", "relit", IMAGE - 0.5, 1.5, gain=4.0)
    write_exr(tmp_path / "x.exr", [grey, colours])
    parts = read_exr(tmp_path / "x.exr")
    assert list(parts) == ["a, grey", "b, relit"]
    np.testing.assert_array_equal(parts["a, grey"], grey.radiance)
    np.testing.assert_array_equal(parts["b, relit"], colours.radiance)  # linear, not brightened


def test_an_error_map_is_signed_and_brightened_as_its_picture():
    truth = Light("a", "truth", IMAGE, 2.0)
    gain = np.where(np.arange(35).reshape(5, 7) % 2, 4.0, 1.0)
    relit = Light("a", "relit", IMAGE + np.float32(0.1), 2.0, gain)
    np.testing.assert_allclose(error_map(relit, truth), 0.05 * gain, rtol=1e-5)
    assert round_limit([np.linspace(-0.013, 0.013, 101)]) == pytest.approx(0.02)
    assert round_limit([np.zeros(4)]) == pytest.approx(1e-5)


def test_the_one_way_to_add_a_figure(tmp_path):
    drawing = new_panels(1, 3, [(5, 7)], 2.0, 0.3)
    relit, truth = (Light("bottle", what, IMAGE * part, 1.0)
                    for what, part in (("relit", 0.9), ("truth", 1.0)))  # fmt: skip
    first, second, third = drawing.axes[0]
    drawing.show(first, relit, "error 10 %")
    drawing.show(second, truth)
    drawing.compare(third, relit, truth)
    drawing.show_errors()
    block = Illustration("Fig. 3.6", "A bottle.", "fig_3_6", drawing)
    (placed,) = place(tmp_path, Section("bottle", "A bottle", [block]))["blocks"]
    assert (placed["png"], placed["exr"]) == ("figures/fig_3_6.png", None)
    assert placed["caption"] == "A bottle. Exposure: white is radiance 1; sRGB tones."
    assert third.images[0].get_clim() == (-10, 10)  # per cent of white


def test_a_drawing_without_errors_has_no_scale():
    figure = Figure()
    drawing = Drawing(figure, figure.subplots(1, 1, squeeze=False))
    drawing.show_errors()
    assert len(drawing.figure.axes) == 1
