"""A transport as a notebook shows it."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping
from html import escape

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.pictures.images import png_bytes

__all__ = ["as_html"]

_WIDTH = 280  # pixels of a notebook's page
_WHITE = 99.5  # per cent of the samples that are not cut off


def as_html(title: str, facts: Mapping[str, str], image: NDArray[np.float32] | None) -> str:
    """Return a table and a picture as HTML that needs nothing else.

    Parameters
    ----------
    title : str
    facts : mapping of str to str
        The table's rows.
    image : ndarray of float32, shape (*camera_shape, C), or None
        Radiance under full light; of several views the one in the middle is shown.
    """
    rows = "".join(
        f"<tr><th style='text-align:left'>{escape(name)}</th>"
        f"<td style='text-align:left'>{escape(text)}</td></tr>"
        for name, text in facts.items()
    )
    table = f"<table><caption><b>{escape(title)}</b></caption>{rows}</table>"
    picture = "" if image is None else _picture(image)
    return (
        "<div style='display:flex;flex-wrap:wrap;gap:1em;align-items:center'>"
        f"{picture}{table}</div>"
    )


def _picture(image: NDArray[np.float32]) -> str:
    domain = RayDomain(image.shape[:-1])
    stack = image.reshape(*domain.stack_shape, -1)
    of_stack = f", view {domain.views // 2} of {domain.views}" if domain.is_stack else ""
    white = float(np.percentile(image, _WHITE)) or float(image.max()) or 1.0
    data = b64encode(png_bytes(stack[domain.views // 2], white)).decode()
    return (
        f"<img src='data:image/png;base64,{data}' alt='under full light{of_stack}' "
        f"title='under full light{of_stack}' style='width:{_WIDTH}px;image-rendering:pixelated'>"
    )
