"""Interaction with a viewer's page by mouse, touch, keys and links, and its accessibility."""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import spearmanr
from tests.results.transports import planar, transport_of
from tests.services.browsers import opened, wait_until

from rfpipe.errors import InputError
from rfpipe.pictures.images import read_image, write_image
from rfpipe.viewer import Comparison, PageContent, write_view

SHAPE = (20, 24)


@pytest.fixture(scope="module")
def symmetric(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page of scene IV, compared with near/far acquisition."""
    comparison = Comparison(transport_of("near_far"), "near/far")
    view = PageContent(transport_of("symmetric"), "Scene IV <small>", comparison=comparison)
    return write_view(view, tmp_path_factory.mktemp("page") / "scene.html").page


@pytest.fixture
def page(chromium: Any, symmetric: Path) -> Iterator[Any]:
    result = opened(chromium, symmetric)
    yield result
    assert result.messages == []
    assert all(re.match(r"file:|blob:|data:", address) for address in result.requests), (
        result.requests
    )
    result.context.close()


def settled(page: Any) -> None:
    """Wait until the picture agrees with the settings."""
    page.wait_for_timeout(50)
    wait_until(page, "!running && !requested && document.body.dataset.shown === stateToHash(state)")


def slide(page: Any, name: str, value: float) -> None:
    """Move a slider by mouse."""
    page.locator(f"#{name}").fill(str(value))
    settled(page)


def shown(page: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the light (C, rays) and the picture (C, rays) of the page."""
    result = page.evaluate("[[...shown.light], shown.colour, [...shown.picture]]")
    light, colour, picture = map(np.array, result)
    coloured = light.size == picture.size
    return light.reshape(3, -1) if coloured else np.outer(colour, light), picture.reshape(3, -1)


def relit(light: np.ndarray, transport: Any) -> np.ndarray:
    shape = transport.projector_shape
    return planar(transport.relight(light.T.reshape(*shape, 3)), transport.camera_shape, 3)


def alike(page: Any, transport: Any) -> None:
    light, picture = shown(page)
    expected = relit(light, transport)
    assert light.max() > 0
    np.testing.assert_allclose(picture, expected, atol=1e-3 * expected.max())


def place(page: Any, canvas: str, x: float, y: float) -> tuple[float, float]:
    """Return the position on the page of a point of the picture, given as fractions."""
    box = page.locator(canvas).bounding_box()
    width = min(box["width"], box["height"] * SHAPE[1] / SHAPE[0])
    return box["x"] + (box["width"] - width) / 2 + x * width, box["y"] + y * box["height"]


def drag(page: Any, canvas: str, begin: tuple[float, float], end: tuple[float, float]) -> None:
    """Drag between two points of the picture, given as fractions."""
    page.mouse.move(*place(page, canvas, *begin))
    page.mouse.down()
    page.mouse.move(*place(page, canvas, *end), steps=3)
    page.mouse.up()
    settled(page)


@pytest.mark.parametrize("canvas", ["#light", "#seen"])
def test_a_dragged_spot_of_any_colour_is_relit(page: Any, canvas: str) -> None:
    page.locator("#colour").fill("#ff8040")
    slide(page, "size", 20)
    drag(page, canvas, (0.2, 0.2), (0.7, 0.6))
    state = page.evaluate("state")
    assert (state["x"], state["y"]) == pytest.approx((0.7, 0.6), abs=0.02)
    alike(page, transport_of("symmetric"))


def test_bars_brushes_and_floodlight_are_relit(page: Any) -> None:
    lit = {}
    for tool in ("bar", "flood", "brush"):
        page.locator(f"[data-tool={tool}]").click()
        if tool == "brush":
            drag(page, "#light", (0.2, 0.8), (0.5, 0.8))
        settled(page)
        alike(page, transport_of("symmetric"))
        lit[tool] = np.count_nonzero(shown(page)[0][0])
    assert lit["flood"] == 480 > lit["bar"] > lit["brush"] > 10


def test_a_picture_is_used_as_light(page: Any, tmp_path: Path) -> None:
    picture = np.zeros((40, 48, 3), np.float32)
    picture[:, :24, 0] = 1
    write_image(tmp_path / "light.png", picture, 1.0)
    page.locator("[data-tool=picture]").click()
    page.locator("#file").set_input_files(tmp_path / "light.png")
    wait_until(page, "loadedPicture !== null")
    settled(page)
    light = shown(page)[0].reshape(3, *SHAPE)
    assert light[0, :, :11].min() > 0.95
    assert light[0, :, 13:].max() < 0.05
    assert light[1:].max() < 0.05


def test_a_pixel_s_row_shows_where_its_light_comes_from(page: Any) -> None:
    page.locator("[data-tool=pixel]").click()
    page.mouse.click(*place(page, "#seen", 5.5 / 24, 7.5 / 20))
    settled(page)
    page.wait_for_timeout(200)
    pixels = "[...$('light').getContext('2d').getImageData(0, 0, 24, 20).data]"
    row = np.array(page.evaluate(pixels)).reshape(20, 24, 4)[..., :3].sum(-1)
    expected = transport_of("symmetric").T.relight(np.eye(480)[7 * 24 + 5].reshape(SHAPE)).sum(-1)
    assert np.unravel_index(row.argmax(), SHAPE) == np.unravel_index(expected.argmax(), SHAPE)
    assert spearmanr(row.ravel(), expected.ravel()).statistic > 0.9


def test_the_camera_s_side_can_be_lit(page: Any) -> None:
    page.locator("#side").select_option("camera")
    settled(page)
    assert page.inner_text("#seen-name") == "Projector's view"
    alike(page, transport_of("symmetric").T)


def test_wipe_and_difference_show_both_transports(page: Any) -> None:
    page.locator("[data-tool=flood]").click()
    slide(page, "wipe", 50)
    light, picture = shown(page)
    expected_other = relit(light, transport_of("near_far"))
    error = np.linalg.norm(picture - expected_other) / np.linalg.norm(expected_other)
    output = float(re.search(r"Differs by ([\d.e-]+) %", page.inner_text("#compared"))[1])
    assert output == pytest.approx(100 * error, rel=0.05)
    before = page.evaluate("$('seen').toDataURL()")
    page.locator("#difference").check()
    settled(page)
    assert page.evaluate("$('seen').toDataURL()") != before


def test_keys_move_the_light_and_change_its_size(page: Any) -> None:
    page.locator("#light").focus()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Shift+ArrowUp")
    page.keyboard.press("+")
    settled(page)
    state = page.evaluate("state")
    assert state["x"] == pytest.approx(0.5 + 1 / 24)
    assert state["y"] == pytest.approx(0)
    assert state["size"] == 9


def test_a_link_restores_everything(page: Any, chromium: Any, symmetric: Path) -> None:
    page.locator("[data-tool=bar]").click()
    page.locator("#colour").fill("#20ff80")
    page.locator("#tone").select_option("log")
    for name, value in (("angle", 30), ("exposure", 4), ("level", 2), ("wipe", 40)):
        slide(page, name, value)
    drag(page, "#light", (0.2, 0.2), (0.3, 0.7))
    page.locator("#link").click()
    restored = opened(chromium, symmetric, page.evaluate("location.hash"))
    settled(restored)
    wait_until(restored, "shown.compared !== null")
    settled(restored)
    picture = "$('seen').toDataURL()"
    assert restored.evaluate(picture) == page.evaluate(picture)
    assert restored.input_value("#angle") == "30"
    restored.context.close()


def test_a_damaged_link_still_opens(chromium: Any, symmetric: Path) -> None:
    damaged = "#size=abc&colour=red&tone=none&level=99&path=%%%&seenView=7&nothing=1"
    page = opened(chromium, symmetric, damaged)
    settled(page)
    alike(page, transport_of("symmetric"))
    assert page.evaluate("[state.seenView, state.tone]") == [0, "soft"]
    assert page.messages == []
    page.context.close()


def test_a_path_is_recorded_and_played(page: Any) -> None:
    page.locator("#record").click()
    for x in (0.2, 0.5, 0.8):
        drag(page, "#light", (x, 0.3), (x, 0.6))
        page.wait_for_timeout(120)
    page.locator("#record").click()
    path = page.evaluate("state.path")
    assert len(path) % 4 == 0
    assert len(path) > 12
    assert "recorded" in page.inner_text("#path")
    page.locator("#play").click()
    wait_until(page, "state.x < 0.3")
    wait_until(page, "state.x > 0.7")


@pytest.mark.parametrize(("scale", "factor"), [(None, 32), ("1", 1), ("4", 4)])
def test_the_picture_is_saved_at_a_size(
    page: Any, tmp_path: Path, scale: str | None, factor: int
) -> None:
    if scale is not None:
        page.locator("#scale").select_option(scale)
        slide(page, "size", 20)  # this doesn't change the size
    with page.expect_download() as download:
        page.locator("#save").click()
    download.value.save_as(tmp_path / "saved.png")
    saved = read_image(tmp_path / "saved.png")
    assert saved.shape == (factor * SHAPE[0], factor * SHAPE[1], 3)
    pixels = saved[::factor, ::factor]
    np.testing.assert_array_equal(saved, pixels.repeat(factor, axis=0).repeat(factor, axis=1))
    assert page.inner_text("#kept").endswith(f"{saved.shape[1]} x {saved.shape[0]} pixels.")


def test_the_text_of_a_comparison_is_removed_with_it(page: Any) -> None:
    def begin() -> None:
        page.locator("#difference").check()
        settled(page)
        assert "Differs by" in page.inner_text("#compared")

    ends = {
        "reset": lambda: page.locator("#reset").click(),
        "difference": lambda: page.locator("#difference").uncheck(),
        "play": lambda: page.locator("#play").click(),
    }
    for name, end in ends.items():
        begin()
        end()
        if name == "play":
            wait_until(page, "$('compared').textContent === ''")
        else:
            settled(page)
        assert page.inner_text("#compared") == "", name
    page.locator("#play").click()
    with page.expect_download():
        page.locator("#save").click()
    wait_until(page, "$('kept').textContent !== ''")
    page.locator("#reset").click()
    assert page.inner_text("#kept") == ""


@pytest.mark.parametrize("width", [1280, 1920])
def test_all_parts_of_the_page_are_in_one_column(page: Any, width: int) -> None:
    page.set_viewport_size({"width": width, "height": 1000})
    boxes = [page.locator(part).bounding_box() for part in ("header", "main", "footer")]
    assert len({(box["x"], box["width"]) for box in boxes}) == 1


@pytest.mark.parametrize("colours", ["light", "dark"])
@pytest.mark.parametrize("width", [1280, 400])
def test_axe_reports_no_accessibility_problem(
    chromium: Any, symmetric: Path, colours: str, width: int
) -> None:
    page = opened(chromium, symmetric, color_scheme=colours)
    page.set_viewport_size({"width": width, "height": 900})
    page.locator("summary").click()
    page.evaluate(files("axe_playwright_python").joinpath("axe.min.js").read_text("utf-8"))
    for tool in ("spot", "bar", "brush", "picture", "pixel"):
        page.locator(f"[data-tool={tool}]").click()
        result = page.evaluate("axe.run()")["violations"]
        assert [(violation["id"], violation["nodes"][0]["html"]) for violation in result] == []
        controls = page.locator(".controls").bounding_box()
        assert (
            width == 400 or controls["y"] + controls["height"] <= 900
        )  # visible without scrolling
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.context.close()


def test_parts_of_the_light_are_switched_on_and_off(chromium: Any, tmp_path: Path) -> None:
    transport = transport_of("near_far")
    page = opened(
        chromium, write_view(PageContent(transport, "Parts"), tmp_path / "near.html").page
    )
    page.locator("#parts input[value=direct]").uncheck()
    settled(page)
    light, picture = shown(page)
    indirect = relit(light, transport) - relit(light, transport.parts[0])
    np.testing.assert_allclose(picture, indirect, atol=1e-3 * indirect.max())
    page.context.close()


def test_views_are_selected_on_both_sides(chromium: Any, tmp_path: Path) -> None:
    transport = transport_of("light field")
    page = opened(
        chromium, write_view(PageContent(transport, "Views"), tmp_path / "field.html").page
    )
    drag(page, "#seen", (0.9, 0.9), (0.9, 0.8))  # no lit view is the displayed view
    assert page.evaluate("[state.x, state.y]") == [0.5, 0.5]
    slide(page, "litView", 1)
    slide(page, "seenView", 1)
    light = np.array(page.evaluate("[...shown.light]")).reshape(2, 4, 6)
    assert not light[0].any()
    assert light[1].any()
    expected = transport.relight(light)[..., 0]
    picture = np.array(page.evaluate("[...shown.picture]")).reshape(2, 4, 6)
    np.testing.assert_allclose(picture, expected, atol=1e-3 * expected.max())
    assert page.input_value("#seenView") == "1"
    assert page.evaluate("$('seen').getContext('2d').getImageData(0, 0, 6, 4).data[0]") > 0
    page.context.close()


def test_a_small_limit_keeps_the_last_level_and_the_comparison(
    chromium: Any, tmp_path: Path
) -> None:
    transport = transport_of("symmetric")
    comparison = Comparison(transport.relight(np.ones(SHAPE)), "the truth")
    written = write_view(
        PageContent(transport, "Large", comparison=comparison), tmp_path / "big.html", 1000
    )
    assert written.levels == [transport.last_level]
    page = opened(chromium, written.page, "#tool=flood&difference=true")
    settled(page)
    alike(page, transport)
    wait_until(page, "still !== null")
    settled(page)
    assert "Differs by" in page.inner_text("#compared")
    assert page.messages == []
    page.context.close()


def test_the_kernel_is_compiled_from_its_source() -> None:
    import wasmtime

    kernel = files("rfpipe.viewer").joinpath("kernel")
    source = kernel.joinpath("kernels.wat").read_text("utf-8")
    assert bytes(wasmtime.wat2wasm(source)) == kernel.joinpath("kernels.wasm").read_bytes()


def test_incomparable_transports_are_refused(tmp_path: Path) -> None:
    comparison = Comparison(transport_of("one channel"), "other")
    with pytest.raises(InputError, match="transports of the same rig"):
        write_view(
            PageContent(transport_of("symmetric"), "", comparison=comparison), tmp_path / "a.html"
        )
