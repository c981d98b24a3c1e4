"""Checking a report that was written: no figure missing, none blank, no link dangling."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from rfpipe.errors import StoreError
from rfpipe.report.entries import RESULTS_NAME, FigureEntry, Panel, Results, read_results
from rfpipe.report.light import read_exr

__all__ = ["check_report"]

_LINK = re.compile(r'(?:href|src)="(?!#|data:)([^"]+)"')
_EMBEDDED = re.compile(r'<img src="data:image/png;base64,')


def check_report(folder: Path) -> Results:
    """Check a report's folder.

    Each figure of ``results.json`` has its PNG, which is not of one colour; one of light has its
    OpenEXR, finite and not of one number in all parts; another one has something drawn. The page
    shows as many figures, and all files that it links are there.

    Parameters
    ----------
    folder : Path
        With ``index.html`` and ``results.json``.

    Returns
    -------
    Results
        What ``results.json`` holds.

    Raises
    ------
    StoreError
        With everything that is wrong, a line each.
    """
    results = read_results(folder / RESULTS_NAME)
    wrong = [fault for figure in results.figures for fault in _faults(figure, folder)]
    wrong += _page_faults(folder / "index.html", len(results.figures))
    if wrong:
        listed = "\n  ".join(wrong)
        raise StoreError(f"{folder}: not a whole report; run the report stage again:\n  {listed}")
    return results


def _faults(figure: FigureEntry, folder: Path) -> list[str]:
    """Say what is wrong with a figure."""
    faults = []
    png = folder / figure.png
    if not png.is_file():
        faults.append(f"{figure.png}: missing")
    elif _is_blank_png(png):
        faults.append(f"{figure.png}: blank, all pixels are of one colour")
    if figure.exr is None:
        if not any(map(_is_drawn, figure.panels)):
            faults.append(f"{figure.png}: blank, nothing is drawn in its panels")
    elif not (folder / figure.exr).is_file():
        faults.append(f"{figure.exr}: missing")
    else:
        faults += _exr_faults(figure, folder)
    return faults


def _is_blank_png(path: Path) -> bool:
    import OpenImageIO as oiio

    pixels = oiio.ImageBuf(str(path)).get_pixels(oiio.UINT8)
    return pixels is None or bool((pixels == pixels[:1, :1]).all())


def _is_drawn(panel: Panel) -> bool:
    """Tell whether a panel has data: reference lines at one place are none."""
    return bool(panel.image or panel.bars or any(len(it.x) and len(it.y) for it in panel.curves))


def _exr_faults(figure: FigureEntry, folder: Path) -> list[str]:
    parts = read_exr(folder / str(figure.exr))
    faults = [
        f"{figure.exr}: {name} holds numbers that aren't finite"
        for name, light in parts.items()
        if not np.isfinite(light).all()
    ]
    missing = {exposure.picture for exposure in figure.exposures} - set(parts)
    faults += [f"{figure.exr}: {name} is missing" for name in sorted(missing)]
    if all(np.ptp(light) == 0 for light in parts.values()):
        faults.append(f"{figure.exr}: blank, each picture is of one number")
    return faults


def _page_faults(page: Path, n_figures: int) -> list[str]:
    if not page.is_file():
        return [f"{page.name}: missing"]
    text = page.read_text(encoding="utf-8")
    shown = len(_EMBEDDED.findall(text))
    faults = [
        f"{page.name}: links {link}, which is missing"
        for link in dict.fromkeys(_LINK.findall(text))
        if not (page.parent / link).is_file()
    ]
    if shown != n_figures:
        faults.append(f"{page.name}: shows {shown} figures; expected {n_figures}")
    return faults
