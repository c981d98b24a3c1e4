"""Access to the viewer's pages in a browser."""

from __future__ import annotations

from base64 import b64decode, b64encode
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray


def opened(chromium: Any, address: str | Path, query: str = "", **context: Any) -> Any:
    """Open a viewer's page and wait for its data; `messages` collects its console messages."""
    page = chromium.new_context(viewport={"width": 1280, "height": 900}, **context).new_page()
    page.messages = []
    page.on("console", lambda message: page.messages.append(message.text))
    page.on("pageerror", lambda error: page.messages.append(str(error)))
    page.requests = []
    page.on("request", lambda request: page.requests.append(request.url))
    page.goto(f"file://{address}{query}" if isinstance(address, Path) else address + query)
    wait_until(page, "document.body.dataset.ready !== undefined")
    return page


def wait_until(page: Any, condition: str, seconds: float = 60) -> None:
    """Wait for a condition; the page forbids the eval that `page.wait_for_function` needs."""
    for _ in range(int(20 * seconds)):
        if page.evaluate(condition):
            return
        page.wait_for_timeout(50)
    status = page.inner_text("#status")
    pytest.fail(f"{condition}: not in {seconds} s; the page says {status!r}, {page.messages}")


_PICTURE = """async ([light, dual, level]) => {
  const bytes = Uint8Array.from(atob(light), (c) => c.charCodeAt(0));
  const parts = MANIFEST.parts.map(() => true);
  const picture = await engine.picture({ light: new Float32Array(bytes.buffer),
    colour: Array(MANIFEST.channels).fill(1), dual, level, parts });
  const all = new Uint8Array(picture.buffer);
  let text = "";
  for (let i = 0; i < all.length; i += 8192) {
    text += String.fromCharCode(...all.subarray(i, i + 8192));
  }
  return btoa(text);
}"""


def picture_of(page: Any, light: NDArray[Any], level: int, dual: bool) -> NDArray[np.float32]:
    """Return the picture that a page computes from light (C, rays), as a flat array."""
    given = b64encode(np.ascontiguousarray(light, "<f4").tobytes()).decode()
    encoded = page.evaluate(_PICTURE, [given, dual, level])
    return np.frombuffer(b64decode(encoded), "<f4")
