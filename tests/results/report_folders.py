"""Small results folders in the workflow's layout, and a parser of report pages."""

import base64
from collections.abc import Iterable
from html.parser import HTMLParser
from itertools import product
from pathlib import Path

from rfpipe.config import Config
from rfpipe.photometry import sensor_from_config
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes import scene_from_config
from rfpipe.stages import evaluate, relight
from rfpipe.stages.acquire import acquire
from rfpipe.store import write_manifest
from rfpipe.transport import save_transport

PLANE = {"kind": "plane", "surfaces": ["texture"], "shape": [8, 10]}
WEDGE = {"kind": "wedge", "surfaces": ["texture", "texture"], "shape": [8, 10]}

BOTH = Config.model_validate(
    {
        "scenes": {"flat": PLANE, "corner": WEDGE},
        "methods": {"symmetric": {}, "dual": {}},
        "report": {
            "title": "Two <small> scenes",
        },
    }
)
GREY = Config.model_validate(
    {
        "scenes": {"grey": {**WEDGE, "channels": 1, "shape": [5, 6]}},
        "methods": {"brute_force": {}},
        "camera": None,
    }
)
FIELD = Config.model_validate(
    {
        "scenes": {
            "corner": WEDGE,
            "field": {
                "kind": "room", "surfaces": ["texture", "white", "white"], "shape": [6, 9],
                "views": [2, 3], "methods": {"symmetric": {}},
            },
        },
        "methods": {"symmetric": {}, "dual": {}},
    }
)  # fmt: skip


class Page(HTMLParser):
    """Parser of a page: its headings, anchors, links, images, tables and text."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.anchors: list[str] = []
        self.links: list[str] = []
        self.images: list[bytes] = []
        self.words = ""
        source = path.read_text(encoding="utf-8")
        self.feed(source)
        self.source = source

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        if "id" in values:
            self.anchors.append(values["id"])
        if "href" in values:
            self.links.append(values["href"])
        if tag == "img":
            kind, data = values["src"].split(",", 1)
            assert kind == "data:image/png;base64"
            self.images.append(base64.b64decode(data))

    def handle_data(self, data):
        self.words += f" {data.strip()}"


def acquired(results: Path, config: Config) -> None:
    """Fill a results folder in the layout of the workflow's stages."""
    relit = []
    for scene, method in config.acquisitions:
        settings, folder = config.scenes[scene], results / scene / method
        rig = SimulatedRig(scene_from_config(settings), sensor_from_config(config.camera), 1)
        selection = config.methods_of(scene)[method]
        options = selection.options()
        result = acquire(rig, selection.plugin, progress=False, **options)
        digest = save_transport(result.transport, folder / "transport.zarr")
        facts = {"scene": scene, "method": method, "options": options}
        manifest = {**facts, "digest": digest, "patterns": result.patterns}
        write_manifest(folder / "transport.json", manifest)
        relight.run(folder, settings, "code")
        relit.append(folder / "relight.json")
    evaluate.run(relit, *tables_of(results), 2.0)


def tables_of(results: Path) -> tuple[Path, Path]:
    tables = results / "report" / "tables"
    return tables / "errors.csv", tables / "speed_error.csv"


def benchmarked(results: Path, scenes: Iterable[str], methods: Iterable[str]) -> None:
    """Write benchmark files as Snakemake does: one second per job, 20 pictures per capture."""
    for scene, method in product(scenes, methods):
        folder = results / scene / method
        for level in ("L00", "L01"):
            (folder / level).mkdir(exist_ok=True)
            for stage in ("schedule", "capture", "merge", "normalize", "refine"):
                path = folder / level / f"{stage}.benchmark.tsv"
                path.write_text("s\th:m:s\tmax_rss\n1.0\t0:00:01\t50\n")
            facts = {"patterns": 20, "shape": [20, 4, 8, 10, 3]}
            write_manifest(folder / level / "capture.json", facts)
        (folder / "transport.benchmark.tsv").write_text("s\th:m:s\n1.0\t0:00:01\n")
