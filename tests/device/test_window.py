"""The projector's window, read back from its display's memory, pixel for pixel."""

import os
import signal
import threading
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from tests.displays import DISPLAYS, OWN_NAME
from tests.waiting import wait_until

from rfpipe.errors import CaptureError, InputError
from rfpipe.rigs.displays import VirtualDisplay, XServer, memory_display
from rfpipe.rigs.window import WindowProjector, code_table, read_response
from rfpipe.testing import ProjectorContract

GAMMA = np.linspace(0.01, 1, 256) ** 2.2


class OnDisplay(ProjectorContract):
    """The suite on an X server in memory, and on a mere array."""

    light_of_code = np.linspace(0, 1, 256)
    offset = (0, 0)

    @pytest.fixture(autouse=True)
    def _on(self, display: VirtualDisplay) -> None:
        self.display = display

    def read_back(self, projector):  # type: ignore[no-untyped-def]
        (top, left), (height, width) = self.offset, projector.shape
        codes = self.display.pixels[top : top + height, left : left + width]
        assert (codes == codes[..., :1]).all(), "the window isn't grey"
        return self.light_of_code[codes[..., 0]].astype(np.float32)


class TestWholeDisplay(OnDisplay):
    def make_projector(self) -> WindowProjector:
        return WindowProjector(self.display.name, settle_seconds=0)


class TestPartOfTheDisplay(OnDisplay):
    offset = (11, 23)

    def make_projector(self) -> WindowProjector:
        return WindowProjector(
            self.display.name, offset=self.offset, shape=(50, 61), settle_seconds=0
        )


class TestWithAMeasuredResponse(OnDisplay):
    light_of_code = (GAMMA - GAMMA[0]) / (GAMMA[-1] - GAMMA[0])
    accuracy = float(np.diff(light_of_code).max() / 2) + 1e-4

    def make_projector(self) -> WindowProjector:
        return WindowProjector(self.display.name, settle_seconds=0, response=GAMMA)


def test_a_window_that_was_killed_is_opened_again(display: VirtualDisplay) -> None:
    with WindowProjector(display.name, settle_seconds=0) as projector:
        white = np.ones(projector.shape, np.float32)
        os.kill(projector._window._process.pid, signal.SIGKILL)
        projector._window._process.wait()
        projector.show(white)
        assert (display.pixels == 255).all()
        assert projector.statistics["reopened"] == 1


@pytest.mark.needs("xvfb")
def test_a_window_that_is_moved_is_put_back(x_display: VirtualDisplay) -> None:
    from Xlib.display import Display

    with WindowProjector(x_display.name, settle_seconds=0) as projector:
        client = Display(x_display.name)
        for window in client.screen().root.query_tree().children:
            window.configure(x=7, y=5)
        client.sync()
        client.close()
        time.sleep(0.2)
        projector.show(np.ones(projector.shape, np.float32))
        assert (x_display.pixels == 255).all()


@pytest.mark.parametrize("kind", DISPLAYS)
def test_a_lost_display_is_an_error_and_not_the_end(kind: str) -> None:
    display = {"x server": partial(XServer, name=OWN_NAME), "memory": memory_display}[kind]
    with display((40, 50)) as server:
        projector = WindowProjector(server.name, settle_seconds=0, reopen_seconds=0.5)
    white = np.ones((40, 50), np.float32)
    assert not projector.undisturbed()
    for _ in range(3):  # at every picture, what happened first is said
        with pytest.raises(
            CaptureError, match=rf"display {server.name}: .*tried to open it again.*DISPLAY"
        ) as failure:
            projector.show(white)
        first = {"x server": "window is gone", "memory": "the display is gone"}[kind]
        assert first in str(failure.value)
        assert "closed file" not in str(failure.value)
    projector.close()
    with pytest.raises(CaptureError, match="closed"):
        projector.show(white)


@pytest.mark.needs("xvfb")
def test_a_display_that_comes_back_goes_on(caplog: pytest.LogCaptureFixture) -> None:
    white = np.ones((40, 50), np.float32)
    with (
        XServer((40, 50), name=OWN_NAME) as server,
        WindowProjector(OWN_NAME, settle_seconds=0, reopen_seconds=0) as projector,
    ):
        projector.show(white)
        os.kill(server.pid, signal.SIGKILL)
        os.waitpid(server.pid, 0)
        assert not projector.undisturbed()
        with pytest.raises(CaptureError, match="window is gone"):
            projector.show(white)
        server.revive()
        assert server.name == OWN_NAME
        projector.show(white)
        assert projector.undisturbed()
        assert (server.pixels == 255).all()
        assert projector.statistics == {"shown": 2, "reopened": 1, "disturbed": 1}
    assert "going on" in caplog.text


def test_a_lost_display_is_not_waited_for_by_who_closes() -> None:
    with memory_display((40, 50)) as server:
        projector = WindowProjector(server.name, settle_seconds=0, reopen_seconds=600)
    threading.Timer(0.5, projector.close).start()
    began = time.monotonic()
    with pytest.raises(CaptureError, match="closed"):
        projector.show(np.ones((40, 50), np.float32))
    assert time.monotonic() - began < 30


@pytest.mark.needs("xvfb")
def test_it_tells_when_its_picture_was_hidden(x_display: VirtualDisplay) -> None:
    with WindowProjector(x_display.name, settle_seconds=0) as projector:
        white = np.ones(projector.shape, np.float32)
        for _ in range(10):  # never without a reason
            projector.show(white)
            assert projector.undisturbed()
        cover_for_a_while(x_display)
        assert not projector.undisturbed()
        projector.show(white)
        assert projector.undisturbed()


def test_without_a_display_it_says_what_to_set(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(CaptureError, match=r"display unset: no display answers.*DISPLAY"):
        WindowProjector()


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"screen": 3}, "there is no monitor 3; this display has 1"),
        ({"shape": (200, 160)}, r"\(200, 160\) pixels at \(0, 0\) doesn't fit on monitor 0"),
        ({"offset": (120, 0)}, "doesn't fit"),
    ],
)
def test_what_does_not_fit_is_explained(display, settings, expected) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(CaptureError, match=expected):
        WindowProjector(display.name, **settings)


def test_the_window_ends_with_its_owner(display: VirtualDisplay) -> None:
    projector = WindowProjector(display.name)
    process = projector._window._process
    projector._window._connection.close()
    assert process.wait(timeout=60) == 0
    projector.close()


def test_codes_give_the_nearest_light() -> None:
    weights = np.arange(65536) / 65535
    light = (GAMMA - GAMMA[0]) / (GAMMA[-1] - GAMMA[0])
    off = np.abs(light[code_table(GAMMA)] - weights)
    best = np.abs(light[:, None] - weights[::97]).min(axis=0)
    assert off[::97] == pytest.approx(best, abs=1e-12)


@pytest.mark.parametrize(
    ("light", "expected"),
    [
        (np.ones(256), "255 must be brighter than 0"),
        (np.r_[np.linspace(0, 1, 255), 0.5], "light of code 255 is 0.5, below that of code 254"),
        (np.linspace(0, 1, 100), r"shape \(100,\)"),
        (np.r_[np.linspace(0, 1, 255), np.nan], "finite"),
    ],
)
def test_a_response_must_be_one(light: np.ndarray, expected: str) -> None:
    with pytest.raises(InputError, match=expected):
        code_table(light)


def test_a_response_is_read_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "response.txt"
    np.savetxt(path, GAMMA)
    assert read_response(path) == pytest.approx(GAMMA)
    np.savetxt(path, GAMMA[:200])
    with pytest.raises(InputError, match=r"response\.txt: .*a table of shape \(200,\)"):
        read_response(path)
    path.write_text("light\n")
    with pytest.raises(InputError, match=r"response\.txt: can't be read"):
        read_response(path)
    with pytest.raises(InputError, match="can't be read"):
        read_response(tmp_path / "absent.txt")


def cover_for_a_while(x_display: VirtualDisplay) -> None:
    """Hide a part of a white window, until it is drawn again."""
    from Xlib.display import Display

    client = Display(x_display.name)
    screen = client.screen()
    cover = screen.root.create_window(
        0, 0, 90, 70, 0, screen.root_depth, background_pixel=0, override_redirect=True
    )
    cover.map()
    client.sync()
    wait_until(lambda: not x_display.pixels[:20, :20].any(), "the cover")
    cover.destroy()
    client.sync()
    wait_until(lambda: bool((x_display.pixels == 255).all()), "the picture again")
    client.close()
