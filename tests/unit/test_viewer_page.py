"""Pictures of the viewer's page in a browser equal pictures computed in Python."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.results.transports import KINDS, lights, planar, transport_of
from tests.services.browsers import opened, picture_of

from rfpipe.transport import Transport, open_transport, save_transport
from rfpipe.viewer import PageContent, write_view

KERNELS = ("", "?kernel=javascript")


def check_pictures(page: Any, transport: Transport, level: int, *, dual: bool) -> None:
    """Check that the page computes the same pictures as Python."""
    for light in lights(transport.projector_shape, transport.channels):
        relit = transport.relight(light)
        expected = planar(relit, transport.camera_shape, transport.channels)
        given = planar(light, transport.projector_shape, transport.channels)
        actual = picture_of(page, given, level, dual).reshape(expected.shape)
        limit = 2e-4 * np.abs(expected).max() + 1e-12
        assert np.abs(actual - expected).max() < limit, (level, dual)


@pytest.mark.parametrize("kind", KINDS)
def test_pictures_equal_those_of_python(chromium: Any, kind: str, tmp_path: Path) -> None:
    transport = transport_of(kind)
    if kind.endswith("uint8"):
        save_transport(transport, tmp_path / "transport.zarr", "uint8")
        transport = open_transport(tmp_path / "transport.zarr")
    path = write_view(PageContent(transport, "A scene"), tmp_path / "scene.html").page
    for kernel in KERNELS:
        page = opened(chromium, path, kernel)
        assert page.evaluate("document.body.dataset.kernel") == ("javascript" if kernel else "wasm")
        levels = page.evaluate("MANIFEST.levels")
        for level in {levels[-1], levels[len(levels) // 2]}:
            visible = transport.truncate(level)
            check_pictures(page, visible, level, dual=False)
            check_pictures(page, visible.T, level, dual=True)
        assert page.messages == []
        page.context.close()
