"""The catalogue: every acquisition of a run on one page, with what became of it."""

from __future__ import annotations

import json
import re
from collections import Counter
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.errors import RfpipeError
from rfpipe.stages.folder import AcquisitionFolder
from rfpipe.store import StoreLock, open_arrays, read_manifest
from rfpipe.store.files import write_atomically

if TYPE_CHECKING:
    from rfpipe.config import Config, SceneSettings

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
        loader=PackageLoader("rfpipe.report", "."),
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


State = Literal["waiting", "running", "unknown", "stopped", "failed", "done"]

_ERROR = re.compile(r"^\d{4}-\d\d-\d\d [\d:,]+ ERROR (.*)$", re.MULTILINE)
_STOPPED = "stopped; what is done is kept"
_LONGEST_WHY = 400
_TAIL_BYTES = 65_536
_READ = ("transport.json", "relight.json", "verification.json", "L00/merge.json")
"""Manifests that an item's figures and picture come from."""


@dataclass
class Item:
    """A row of the catalogue.

    Attributes
    ----------
    scene, method : str
    state : {"waiting", "running", "unknown", "stopped", "failed", "done"}
        Unknown where another machine's process began it, and can't be asked from here.
    why : str
        Of one that failed, the message; of one that runs or was stopped, where and how far it came.
    patterns : int or None
        Shown.
    error : float or None
        Mean relative error of relit pictures against the truth, where that is known.
    estimate : float or None
        The method's own estimate of that error, if it has one.
    verified : float or None
        Mean relative error against pictures that no method saw, taken after the acquisition.
    seconds : float or None
        Of the acquisition's job.
    nbytes : int or None
        Of the stored transport.
    """

    scene: str
    method: str
    state: State = "waiting"
    why: str = ""
    patterns: int | None = None
    error: float | None = None
    estimate: float | None = None
    verified: float | None = None
    seconds: float | None = None
    nbytes: int | None = None

    def plain(self) -> dict[str, Any]:
        """Return it as plain data."""
        return asdict(self)


def stamp_of(folder: Path) -> list[int]:
    """Return what changes when any of the manifests that an item is made of does."""
    return [_modified(folder / name) for name in _READ]


def item_of(folder: Path, known: dict[str, Any] | None = None) -> Item:
    """Read what there is of an acquisition.

    Parameters
    ----------
    folder : Path
        ``results/{scene}/{method}``; it needn't exist.
    known : dict, optional
        `Item.plain` of the same manifests: their figures aren't read again.
    """
    item = Item(folder.parent.name, folder.name)
    if not folder.exists():
        return item
    holder = StoreLock.holder(folder)
    if holder is not None and holder.is_known:
        on = f"on {holder.where}: " if holder.where else ""
        item.state, item.why = "running", on + _reached(folder)
    elif (folder / "transport.json").exists():
        item.state = "done"
        if known and known["state"] == "done":
            return Item(**known)
        _read_figures(item, folder)
    else:
        item.state, item.why = _ended(folder)
        if holder is not None and item.state == "stopped":
            item.state = "unknown"
            item.why = (
                f"begun on {holder.where}, whose locks don't reach here or which died; "
                f"{_reached(folder)}{_last_sign(folder)}"
            )
    return item


def _modified(path: Path) -> int:
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return 0


def last_log(folder: Path) -> Path | None:
    """Return the log that was written last, of the acquisition or of a stage; None for none."""
    logs = [*folder.glob("*.log"), *folder.glob("L[0-9][0-9]/*.log")]
    return max(logs, key=_modified, default=None)


def _reached(folder: Path) -> str:
    """Say to what level captures are complete."""
    done = sorted(folder.glob("L[0-9][0-9]/capture.json"))
    return f"level {int(done[-1].parent.name[1:])} is captured" if done else "nothing captured yet"


def _last_sign(folder: Path) -> str:
    """Say when an acquisition last wrote anything."""
    signs = [*folder.glob("*.log"), *folder.glob("L[0-9][0-9]/*"), *folder.glob("L[0-9][0-9]")]
    last = max(map(_modified, signs), default=0)
    if not last:
        return ""
    return f", last sign of life {datetime.fromtimestamp(last // 10**9, UTC):%Y-%m-%d %H:%M} UTC"


def _ended(folder: Path) -> tuple[State, str]:
    """Tell how an acquisition without a transport ended, by its last log."""
    try:
        with (last_log(folder) or folder / "acquire.log").open("rb") as file:
            file.seek(0, 2)
            file.seek(max(0, file.tell() - _TAIL_BYTES))
            log = file.read().decode(errors="replace")
    except OSError:
        begun = any(folder.iterdir())
        return ("stopped", _reached(folder)) if begun else ("waiting", "")
    errors = _ERROR.findall(log)
    if not errors or errors[-1].startswith(_STOPPED):
        return "stopped", _reached(folder)
    return "failed", errors[-1][:_LONGEST_WHY]


def _read_figures(item: Item, folder: Path) -> None:
    """Read what the stages left; what is missing or damaged stays unknown."""
    acquired = _manifest(folder / "transport.json")
    item.patterns = acquired.get("patterns")
    item.verified = _manifest(folder / "verification.json").get("mean_error")
    item.error = _mean_error(folder / "relight.json")
    _read_transport(item, folder / "transport.zarr")
    times = [*folder.glob("L[0-9][0-9]/*.benchmark.tsv"), folder / "assemble.benchmark.tsv"]
    known = [seconds for path in times if (seconds := _seconds(path)) is not None]
    item.seconds = sum(known) if known else None


def _manifest(path: Path) -> dict[str, Any]:
    try:
        return read_manifest(path)
    except RfpipeError:
        return {}


def _mean_error(manifest: Path) -> float | None:
    from rfpipe.stages.evaluating.metrics import relative_rms

    if not _manifest(manifest):
        return None
    try:
        images = open_arrays(manifest.with_suffix(".zarr"))
        if "truth" not in images.names:
            return None
        pairs = list(zip(images.read("relit"), images.read("truth"), strict=True))
    except RfpipeError:
        return None
    return sum(relative_rms(relit, truth) for relit, truth in pairs) / len(pairs)


def _read_transport(item: Item, store: Path) -> None:
    from rfpipe.transport import open_transport
    from rfpipe.transport.base import estimates

    try:
        transport = open_transport(store)
        item.nbytes, rows = transport.nbytes, transport.level_rows
    except RfpipeError:
        return
    steps = estimates(rows)
    item.estimate = float(steps[-1]["estimated_error"]) if steps else None


def _seconds(benchmark: Path) -> float | None:
    try:
        names, values, *_ = benchmark.read_text(encoding="utf-8").splitlines()
        return float(dict(zip(names.split("\t"), values.split("\t"), strict=True))["s"])
    except (OSError, ValueError, KeyError):
        return None


def floodlit_of(folder: Path) -> Any:
    """Return the floodlit image of an acquisition, None where it isn't merged, or damaged."""
    from rfpipe.stages.merger import read_floodlit

    try:
        return read_floodlit(AcquisitionFolder(folder))[0]
    except (RfpipeError, KeyError):
        return None


_SIDE = 96
_WHITE_PERCENTILE = 99.5


def write_thumbnail(folder: Path, picture: Path) -> bool:
    """Write the floodlit picture of an acquisition as a small PNG, if it is captured.

    Parameters
    ----------
    folder : Path
        ``results/{scene}/{method}``.
    picture : Path

    Returns
    -------
    bool
        Whether there is one.
    """
    from rfpipe.pictures.images import write_image

    floodlit = floodlit_of(folder)
    if floodlit is None:
        return False
    rays = floodlit.shape[:-1]
    # of a light field, the view in the middle
    domain = RayDomain(rays)
    views = floodlit.reshape(domain.views, *domain.image_shape, floodlit.shape[-1])
    image = _smaller(views[domain.views // 2])
    lit = image[np.isfinite(image)]
    white = float(np.percentile(lit, _WHITE_PERCENTILE)) if lit.size else 1.0
    picture.parent.mkdir(parents=True, exist_ok=True)
    write_image(picture, np.nan_to_num(image), white if white > 0 else 1.0)
    return True


def _smaller(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """Average a picture (H, W, C) over squares of pixels until it is small enough."""
    step = -(-max(image.shape[:2]) // _SIDE)
    height, width = (max(1, side // step) for side in image.shape[:2])
    cut = image[: height * step, : width * step]
    blocks = cut.reshape(height, cut.shape[0] // height, width, cut.shape[1] // width, -1)
    smaller: NDArray[np.float32] = blocks.mean(axis=(1, 3), dtype=np.float32)
    return smaller
