"""The projector's window, read back from an X server, pixel for pixel."""

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from tests.emulators.x_displays import OWN_NAME, XServer
from tests.services.waiting import wait_until

from rfpipe.devices.window import WindowProjector
from rfpipe.errors import CaptureError, InputError
from rfpipe.rigs.devices import code_table
from rfpipe.testing import ProjectorContract

XVFB = pytest.mark.needs("xvfb")
GAMMA = np.linspace(0.01, 1, 256) ** 2.2


@pytest.fixture(scope="module")
def x_server() -> Iterator[XServer]:
    with XServer((120, 160)) as server:
        yield server


@pytest.fixture
def projector(x_server: XServer) -> Iterator[WindowProjector]:
    with WindowProjector(x_server.name, settle_seconds=0) as projector:
        yield projector


@XVFB
class TestPartOfTheDisplayWithAMeasuredResponse(ProjectorContract):
    light_of_code = (GAMMA - GAMMA[0]) / (GAMMA[-1] - GAMMA[0])
    accuracy = float(np.diff(light_of_code).max() / 2) + 1e-4

    @pytest.fixture(autouse=True)
    def _on(self, x_server: XServer) -> None:
        self.server = x_server

    def make_projector(self) -> WindowProjector:
        part: dict[str, Any] = {"offset": (11, 23), "shape": (50, 61)}
        return WindowProjector(self.server.name, settle_seconds=0, response=GAMMA, **part)

    def read_back(self, projector):  # type: ignore[no-untyped-def]
        codes = self.server.pixels[11:61, 23:84]
        assert (codes == codes[..., :1]).all(), "the window isn't grey"
        return self.light_of_code[codes[..., 0]].astype(np.float32)


def white(projector: WindowProjector) -> np.ndarray:
    return np.ones(projector.shape, np.float32)


@XVFB
def test_a_window_displays_colours(projector: WindowProjector, x_server: XServer) -> None:
    picture = np.random.default_rng(0).random((*projector.shape, 3), np.float32)
    projector.show_colour(picture)
    np.testing.assert_allclose(x_server.pixels[..., ::-1] / 255, picture, atol=0.6 / 255)
    projector.show(picture[..., 0])
    np.testing.assert_allclose(x_server.pixels[..., 2] / 255, picture[..., 0], atol=0.6 / 255)
    for wrong in (picture[..., 0], 2 * picture):
        with pytest.raises(InputError):
            projector.show_colour(wrong)


@XVFB
def test_a_moved_window_is_opened_again_in_place(
    projector: WindowProjector, x_server: XServer
) -> None:
    from Xlib.display import Display

    client = Display(x_server.name)
    for window in client.screen().root.query_tree().children:
        window.configure(x=7, y=5)
    client.sync()
    client.close()
    time.sleep(0.2)
    projector.show(white(projector))
    assert (x_server.pixels == 255).all()


@XVFB
def test_a_lost_display_is_an_error_until_it_comes_back(caplog: pytest.LogCaptureFixture) -> None:
    with XServer((40, 50), OWN_NAME) as server:
        projector = WindowProjector(OWN_NAME, settle_seconds=0)
        projector.show(white(projector))
    assert not projector.undisturbed()
    for _ in range(2):
        with pytest.raises(
            CaptureError, match=rf"display {OWN_NAME}: .*no display is available.*DISPLAY"
        ):
            projector.show(white(projector))
    with XServer((40, 50), OWN_NAME) as server:
        projector.show(white(projector))
        assert projector.undisturbed()
        assert (server.pixels == 255).all()
    assert projector.statistics == {"shown": 2, "reopened": 1, "disturbed": 1}
    assert "window is lost" in caplog.text
    projector.close()
    with pytest.raises(CaptureError, match="closed"):
        projector.show(white(projector))


@XVFB
def test_a_hidden_picture_is_reported_as_disturbed(
    projector: WindowProjector, x_server: XServer
) -> None:
    for _ in range(10):  # never without a reason
        projector.show(white(projector))
        assert projector.undisturbed()
    from Xlib.display import Display

    client = Display(x_server.name)
    screen = client.screen()
    cover = screen.root.create_window(
        0, 0, 90, 70, 0, screen.root_depth, background_pixel=0, override_redirect=True
    )
    cover.map()
    client.sync()
    wait_until(lambda: not x_server.pixels[:20, :20].any(), "the cover")
    cover.destroy()
    client.sync()
    wait_until(lambda: bool((x_server.pixels == 255).all()), "the picture again")
    client.close()
    assert not projector.undisturbed()
    projector.show(white(projector))
    assert projector.undisturbed()


def test_a_missing_display_names_the_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(CaptureError, match=r"display unset: no display is available.*DISPLAY"):
        WindowProjector()


@XVFB
@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"screen": 3}, "there is no monitor 3; this display has 1"),
        ({"shape": (200, 160)}, r"\(200, 160\) pixels at \(0, 0\) doesn't fit on monitor 0"),
    ],
)
def test_pictures_that_do_not_fit_are_explained(
    x_server: XServer, settings: dict[str, Any], expected: str
) -> None:
    with pytest.raises(CaptureError, match=expected):
        WindowProjector(x_server.name, **settings)


@XVFB
def test_the_window_closes_when_its_owner_ends(projector: WindowProjector) -> None:
    process = projector._window._process
    projector._window._connection.close()
    assert process.wait(timeout=60) == 0


@pytest.mark.parametrize(
    "light",
    [np.ones(256), np.r_[np.linspace(0, 1, 255), 0.5], np.linspace(0, 1, 100),
     np.r_[np.linspace(0, 1, 255), np.nan]],
)  # fmt: skip
def test_an_invalid_response_is_refused(light: np.ndarray) -> None:
    with pytest.raises(InputError, match="non-decreasing"):
        code_table(light)
