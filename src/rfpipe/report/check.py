"""Checking a page that was written: no figure blank, no link that leads to nothing."""

from __future__ import annotations

import re
from pathlib import Path

_LINK = re.compile(r'(?:href|src)="(?!#|data:|https?:)([^"]+)"')


def check_page(page: Path) -> list[str]:
    """Return the faults of a page and of the figures beside it.

    Parameters
    ----------
    page : Path
        Such as ``results/report/index.html``, with ``figures/*.png`` beside it.

    Returns
    -------
    list of str
        A sentence each: a link to a file that is missing, a picture of one colour, a page without
        any picture.
    """
    import OpenImageIO as oiio

    text = page.read_text(encoding="utf-8")
    faults = [
        f"{page}: links {link}, which is missing"
        for link in dict.fromkeys(_LINK.findall(text))
        if not (page.parent / link).is_file()
    ]
    if "<img" not in text:
        faults.append(f"{page}: shows no picture")
    for picture in sorted(page.parent.glob("figures/*.png")):
        pixels = oiio.ImageBuf(str(picture)).get_pixels(oiio.UINT8)
        if pixels is None or (pixels == pixels[:1, :1]).all():
            faults.append(f"{picture}: blank, all pixels are of one colour")
    return faults
