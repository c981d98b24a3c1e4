"""Open a dome's relightable image in OpenLIME, in a browser, and compare what it shows.

``python -m benchmarks.openlime DIST TRANSPORT`` exports the transport of a dome, as pictures and as
tiles, and opens both folders in Chromium. DIST is the folder ``dist`` of the npm package
``openlime``. Screenshots and the table are written into ``results/bench``: differences of the
page from the decoder of `benchmarks.photographs.relightable` and from `light_from`, percent of the
norm in sRGB. ``--figure FILE.png`` shows the page beside photographs of the dome.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from shutil import which
from tempfile import TemporaryDirectory
from threading import Thread
from typing import Any
from unittest.mock import patch

import numpy as np

import rfpipe
from benchmarks import harness
from benchmarks.photographs.relightable import decode_folder
from rfpipe.array_types import Double
from rfpipe.export import relightable_images, write_relightable_image
from rfpipe.pictures.images import read_image, srgb

_BROWSERS = ("chromium", "chromium-browser", "google-chrome")
_LIGHTS = ((0.2, 0.1), (0.0, 0.5), (-0.4, 0.3), (0.1, -0.3))


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_: Any) -> None:
        """Print nothing."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure both layouts."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.openlime", description=__doc__)
    parser.add_argument("dist", type=harness.existing, help="folder dist of the npm package")
    parser.add_argument("transport", type=harness.existing, help="of a dome, at most 2,048 pixels")
    parser.add_argument("--figure", type=Path, help="PNG file of the page beside photographs")
    options = parser.parse_args(arguments)
    dist = options.dist.absolute()
    harness.write("openlime", _rows(dist, options.transport))
    if options.figure:
        _write_figure(dist, options.transport, options.figure)


def _rows(dist: Path, path: Path) -> Iterator[dict[str, Any]]:
    transport = rfpipe.open_transport(path)
    with TemporaryDirectory() as temporary:
        for layout, largest in (("image", 2048), ("deepzoom", 256)):
            folder = Path(temporary, layout)
            with patch.object(relightable_images, "LARGEST_PICTURE", largest):
                white = write_relightable_image(transport, folder).white
            (folder / "openlime").symlink_to(dist)
            screenshots = _screenshots(folder, transport.camera_shape, _LIGHTS)
            for (x, y), shown in zip(_LIGHTS, screenshots, strict=True):
                direction = np.array([x, y, np.sqrt(1 - x * x - y * y)])
                truth = srgb(transport.light_from(direction), white)
                decoded = decode_folder(folder, direction)
                yield {
                    "layout": layout,
                    "x": x,
                    "y": y,
                    "decoder": 100 * _relative(shown, decoded),
                    "light_from": 100 * _relative(shown, truth),
                }


def _relative(shown: Double, truth: Double) -> float:
    return float(np.linalg.norm(shown - truth) / max(np.linalg.norm(truth), 1e-9))


def _write_figure(dist: Path, path: Path, file: Path) -> None:
    """Show the page, with its buttons, beside the photographs under two lights of the dome."""
    from matplotlib import pyplot

    transport = rfpipe.open_transport(path)
    directions = np.asarray(transport.lights)
    chosen = [int((directions @ light).argmax()) for light in ((-0.6, 0.3, 0.7), (0.7, 0.5, 0.5))]
    with TemporaryDirectory() as temporary:
        folder = Path(temporary, "figure")
        white = write_relightable_image(transport, folder).white
        (folder / "openlime").symlink_to(dist)
        lights = [tuple(directions[index, :2]) for index in chosen]
        pages = list(_screenshots(folder, transport.camera_shape, lights, has_buttons=True))
    figure, axes = pyplot.subplots(1, 4, figsize=(12, 3.3), layout="constrained")
    for index, page, pair in zip(chosen, pages, axes.reshape(2, 2), strict=True):
        pattern = np.zeros(transport.projector_shape)
        pattern.flat[index] = 1
        photograph = srgb(transport.relight(pattern), white)
        for axis, name, picture in zip(
            pair,
            (f"photograph {index + 1}", "OpenLIME, the same light"),
            (photograph, page),
            strict=True,
        ):
            axis.imshow(np.clip(picture, 0, 1))
            axis.set(title=name, xticks=[], yticks=[])
    figure.savefig(file, dpi=72)


def _screenshots(
    folder: Path,
    shape: tuple[int, ...],
    lights: Sequence[tuple[float, float]],
    *,
    has_buttons: bool = False,
) -> Iterator[Double]:
    """Yield screenshots (H, W, 3) of the folder's page under lights, a pixel for each ray."""
    from playwright.sync_api import sync_playwright

    harness.FOLDER.mkdir(parents=True, exist_ok=True)
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(_Quiet, directory=str(folder)))
    Thread(target=server.serve_forever, daemon=True).start()
    with sync_playwright() as driver:
        browser = driver.chromium.launch(
            executable_path=next(filter(None, map(which, _BROWSERS))), args=["--no-sandbox"]
        )
        page = browser.new_page(viewport={"width": shape[1], "height": shape[0]})
        page.goto(f"http://127.0.0.1:{server.server_port}/index.html")
        page.wait_for_function("layer.status === 'ready'")
        page.wait_for_timeout(3000)
        if not has_buttons:
            page.add_style_tag(content=".openlime > :not(canvas) { display: none !important; }")
        page.evaluate("viewer.camera.fit(layer.boundingBox(), 0)")
        for index, light in enumerate(lights):
            page.evaluate(f"layer.setLight([{light[0]}, {light[1]}], 0)")
            page.wait_for_timeout(1500)
            file = harness.FOLDER / f"openlime_{folder.name}_{index}.png"
            page.screenshot(path=file)
            yield read_image(file)[..., :3].astype(np.float64)
        browser.close()
    server.shutdown()


if __name__ == "__main__":
    main()
