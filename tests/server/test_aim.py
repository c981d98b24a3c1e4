"""The page of `rfpipe aim`: access by token, the camera's view, failed devices."""

import asyncio
from collections.abc import Callable, Iterator
from io import BytesIO

import matplotlib.image as mpimg
import numpy as np
import pytest
from httpx import ASGITransport, AsyncClient, Response
from tests.rigs.calibration_bench import CAMERA, Bench, brighter, wedge_bench
from tests.services.waiting import wait_until

from rfpipe.errors import CaptureError
from rfpipe.server.aim import SceneMonitor, create_app

TOKEN = "a-token-of-the-test"


@pytest.fixture
def bench() -> Bench:
    return wedge_bench((12, 12), (96, 96), (40, 42), sensor=brighter(CAMERA, 10.0))


@pytest.fixture
def watch(bench: Bench) -> Iterator[SceneMonitor]:
    watch = SceneMonitor(lambda: (bench.projector, bench.camera), period=16)
    yield watch
    watch.close()


@pytest.fixture
def get(watch: SceneMonitor) -> Callable[..., Response]:
    """Ask as a browser does, which keeps its cookies."""
    app = ASGITransport(create_app(watch, TOKEN))
    browser = AsyncClient(transport=app, base_url="http://127.0.0.1", follow_redirects=True)
    return lambda path, **options: asyncio.run(browser.get(path, **options))


def wait_for(watch: SceneMonitor, number: int) -> None:
    wait_until(lambda: watch.view.number >= number, f"view {number}")


def test_nothing_is_shown_without_the_token(get: Callable[..., Response]) -> None:
    for path in ("/", "/?token=another", "/state.json", "/picture.png"):
        assert get(path).status_code == 401
    page = get(f"/?token={TOKEN}")
    assert page.status_code == 200
    assert TOKEN not in str(page.url)
    assert "What the camera sees" in page.text
    assert get("/state.json").status_code == 200
    assert get("/state.json", headers={"Host": "elsewhere.example"}).status_code == 400


def test_the_page_shows_the_view_of_the_camera(
    get: Callable[..., Response], watch: SceneMonitor
) -> None:
    get(f"/?token={TOKEN}")
    wait_for(watch, 1)
    state = get("/state.json").json()
    assert state["standing"] == "poor"
    assert "saturated" in state["verdict"]
    assert 0.5 < state["saturated"] <= 1
    proposed = float(state["proposal"].partition("[")[2].partition(",")[0])
    # the brightest then has three quarters of full scale; now it has some eight times all of it
    assert 1 / 64 / 20 < proposed < 1 / 64 / 5
    picture = mpimg.imread(BytesIO(get("/picture.png").content))[..., :3]
    red = (picture[..., 0] > 0.8) & (picture[..., 1] < 0.2)
    assert red.mean() > 0.3
    assert (np.abs(picture - [1.0, 0.82, 0.12]).max(axis=-1) < 0.02).any()  # the outline


def test_the_page_shows_delay_frames_and_light(
    get: Callable[..., Response], watch: SceneMonitor
) -> None:
    get(f"/?token={TOKEN}")
    assert get("/state.json").json()["timing"] == []
    wait_until(lambda: get("/state.json").json()["timing"], "the timing")
    timing = get("/state.json").json()["timing"]
    assert [part["name"] for part in timing] == ["delay", "frames", "light"]
    assert (timing[0]["standing"], timing[1]["standing"]) == ("good", "good")
    assert "0 ms after it was drawn" in timing[0]["text"]


def test_closing_ends_a_measurement(bench: Bench) -> None:
    watch = SceneMonitor(lambda: (bench.projector, bench.camera), period=16)
    wait_for(watch, 1)
    watch.close()  # during the measurement of the delay, which takes two seconds
    assert watch.state["timing"] == []


def test_a_failed_device_is_reported_and_retried(
    get: Callable[..., Response], watch: SceneMonitor, bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    get(f"/?token={TOKEN}")
    wait_for(watch, 1)
    expose = bench.camera.expose

    def fail() -> None:
        raise CaptureError("the cable is out")

    monkeypatch.setattr("rfpipe.server.aim.RETRY_SECONDS", 0.05)
    bench.camera.expose = fail  # type: ignore[method-assign,assignment]
    wait_until(lambda: "cable is out" in (get("/state.json").json()["error"] or ""), "the error")
    bench.camera.expose = expose  # type: ignore[method-assign]
    number = watch.view.number
    wait_for(watch, number + 1)
    assert get("/state.json").json()["error"] is None


def test_devices_that_cannot_be_opened_raise_an_error() -> None:
    def missing() -> None:
        raise CaptureError("no camera answers")

    with pytest.raises(CaptureError, match="no camera answers"):
        SceneMonitor(missing, period=16)  # type: ignore[arg-type]
