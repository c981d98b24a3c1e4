"""Writing the catalogue: at any time, also while acquisitions run."""

from __future__ import annotations

import json
from collections import Counter
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rfpipe.report.catalogue.items import Item, item_of, last_log, stamp_of
from rfpipe.report.catalogue.thumbnails import write_thumbnail
from rfpipe.store.files import write_atomically

if TYPE_CHECKING:
    from rfpipe.config import Config, SceneSettings

__all__ = ["CATALOGUE", "left_over", "write_catalogue"]

CATALOGUE = Path("catalogue") / "index.html"
"""In the folder of results."""

_KNOWN = "items.json"
_STATES = ("failed", "running", "unknown", "stopped", "waiting", "done")


def write_catalogue(settings: Config, results: Path) -> dict[str, int]:
    """Write the page that lists every acquisition of a run.

    What was read of finished acquisitions is kept beside it, so that a page of a thousand takes
    seconds once it was written.

    Parameters
    ----------
    settings : Config
    results : Path
        The run's folder of results; the page is its ``catalogue/index.html``.

    Returns
    -------
    dict
        Acquisitions by state.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    folder = (results / CATALOGUE).parent
    kept, known = _known(folder / _KNOWN), {}
    rows: list[dict[str, Any]] = []
    for scene, method in settings.acquisitions:
        name, place = f"{scene}/{method}", results / scene / method
        stamp, before = stamp_of(place), kept.get(name, {})
        same = before.get("stamp") == stamp
        item = item_of(place, before["item"] if same else None)
        picture = before.get("picture", False) if same else False
        if not picture and stamp[-1]:
            picture = write_thumbnail(place, folder / f"{scene}_{method}.png")
        known[name] = {"stamp": stamp, "item": item.plain(), "picture": picture}
        rows.append(_row(settings, results, item, picture=picture))
    counts = Counter(row["item"].state for row in rows)
    environment = Environment(
        loader=PackageLoader("rfpipe.report.catalogue", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    about = list(dict.fromkeys(key for row in rows for key in row["about"]))
    page = environment.get_template("catalogue.html.j2").render(
        title=Path(settings.collection).stem if settings.collection else settings.title,
        rows=rows,
        about=about,
        shown=_told(rows),
        left=left_over(settings, results),
        states=[(state, counts[state]) for state in _STATES if counts[state]],
        written=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        seconds=sum(row["item"].seconds or 0 for row in rows),
        patterns=sum(row["item"].patterns or 0 for row in rows),
    )
    write_atomically(results / CATALOGUE, page.encode())
    write_atomically(folder / _KNOWN, json.dumps(known).encode())
    return {state: counts[state] for state in _STATES}


def left_over(settings: Config, results: Path) -> list[str]:
    """Return the folders of scenes that the settings don't have any more."""
    begun = {folder.parents[1].name for folder in results.glob("*/*/L00")}
    return sorted(begun - {*settings.scenes})


def _row(settings: Config, results: Path, item: Item, *, picture: bool) -> dict[str, Any]:
    scene = settings.scenes[item.scene]
    view = f"report/view/{item.scene}_{item.method}.html"
    return {
        "item": item,
        "kind": scene.kind,
        "rays": _rays(scene),
        "rig": scene.rig or "",
        "about": scene.about,
        "picture": f"{item.scene}_{item.method}.png" if picture else None,
        "view": f"../{view}" if (results / view).exists() else None,
        "log": _log_of(results, item),
        "order": _STATES.index(item.state),
    }


def _log_of(results: Path, item: Item) -> str | None:
    """Return where the last log of an acquisition lies, as seen from the page."""
    log = last_log(results / item.scene / item.method)
    return None if log is None else f"../{log.relative_to(results).as_posix()}"


def _rays(scene: SceneSettings) -> str:
    """Say how many rays the camera has, and the projector where it has others."""
    camera, lit = (" x ".join(map(str, it)) for it in (scene.camera_ray_shape, scene.ray_shape))
    return camera if camera == lit else f"{camera}, lit by {lit}"


def _told(rows: list[dict[str, Any]]) -> dict[str, bool]:
    """Return which columns have anything to tell."""
    figures = {
        name: any(getattr(row["item"], name) is not None for row in rows)
        for name in ("error", "estimate", "verified")
    }
    return {**figures, "rig": any(row["rig"] for row in rows)}


def _known(path: Path) -> dict[str, Any]:
    """Read what was kept; nothing where it can't be read, as after an update."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        fields = set(Item("", "").plain())
        return {name: it for name, it in found.items() if set(it["item"]) == fields}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}
