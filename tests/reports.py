"""Small results folders as the workflow's stages leave them, and the parts of a report's page."""

import base64
from collections.abc import Iterable
from html.parser import HTMLParser
from pathlib import Path

import numpy as np

from rfpipe.config import Config
from rfpipe.photometry import sensor_from_config
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes import scene_from_config
from rfpipe.stages import relight
from rfpipe.stages.acquire import acquire
from rfpipe.stages.evaluating import evaluate, sweep
from rfpipe.store import write_arrays, write_manifest
from rfpipe.transport import save_transport

PLANE = {"kind": "plane", "surfaces": ["texture"], "shape": [8, 10]}
WEDGE = {"kind": "wedge", "surfaces": ["texture", "texture"], "shape": [8, 10]}

BOTH = Config.model_validate(
    {
        "scenes": {"flat": PLANE, "corner": WEDGE},
        "methods": {"symmetric": {}, "dual": {}},
        "report": {
            "title": "Two <small> scenes",
            "trials": {"symmetric": [0.03, 0.001], "dual": [0.03, 0.001]},
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
                "views": [2, 3], "methods": {"symmetric": {}}, "sweep": False,
            },
        },
        "methods": {"symmetric": {}, "dual": {}},
        "report": {"trials": {"symmetric": [0.01], "dual": [0.01]}},
    }
)  # fmt: skip


class Page(HTMLParser):
    """The parts of a page: its headings, anchors, links, images, tables and text."""

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
    """Fill a results folder as the workflow's stages do."""
    relit, swept = [], []
    for scene, method in config.acquisitions:
        settings, folder = config.scenes[scene], results / scene / method
        rig = SimulatedRig(scene_from_config(settings), sensor_from_config(config.camera), 1)
        options = config.methods_of(scene)[method].options()
        result = acquire(rig, method, progress=False, **options)
        digest = save_transport(result.transport, folder / "transport.zarr")
        about = {"scene": scene, "method": method, "options": options}
        manifest = {**about, "digest": digest, "patterns": result.patterns}
        write_manifest(folder / "transport.json", manifest)
        relight.run(folder, settings, "code")
        relit.append(folder / "relight.json")
        if sweep.is_swept(config, scene, method):
            sweep.run(config, scene, method, folder, "code")
            swept.append(folder / "sweep.json")
    evaluate.run(relit, swept, *tables_of(results), 2.0)


def tables_of(results: Path) -> tuple[Path, Path]:
    tables = results / "report" / "tables"
    return tables / "errors.csv", tables / "speed_error.csv"


def studied(results: Path) -> None:
    """Write studies of made-up numbers."""
    resolution = [
        {"method": method, "side": side, "rays": side**2, "patterns": patterns, "rms_total": None}
        for side in (4, 8)
        for method, patterns in (("brute_force", side**2), ("symmetric", 4 * side))
    ]
    hard = {
        "case": "zero_transport", "scene": "zero transport", "rays": 256, "method": "symmetric",
        "camera": "12 bits", "patterns": None, "matrix_error": None, "relight_error": None,
        "accumulation": None, "refused": "the floodlit image is all black: radiance 0",
    }  # fmt: skip
    mosaic = [
        {"chain": chain, "normalization": mode, "energy": 0.9, "colour_contrast": 0.5, "rms": 0.2,
         "image_error": 0.5}
        for chain in ("linear", "median")
        for mode in ("none", "per_channel", "total_energy")
    ]  # fmt: skip
    images = {
        f"{part}_{chain}{mode}": np.linspace(0.1, 0.9, 72, dtype=np.float32).reshape(4, 6, 3)
        for chain in ("linear", "median")
        for part, modes in (("floodlit", [""]), ("sum", ["_none", "_per_channel", "_total_energy"]))
        for mode in modes
    }
    for name, rows, arrays in (
        ("resolution", resolution, {}), ("stability", [hard], {}), ("mosaic", mosaic, images),
    ):  # fmt: skip
        write_arrays(results / "studies" / f"{name}.zarr", arrays, {})
        write_manifest(results / "studies" / f"{name}.json", {"study": name, "rows": rows})


def benchmarked(results: Path, scenes: Iterable[str], methods: Iterable[str]) -> None:
    """Write files as Snakemake's `benchmark:` does: one second a job."""
    for scene in scenes:
        for method in methods:
            folder = results / scene / method
            for stage in ("schedule", "capture", "merge", "normalize", "refine"):
                for level in ("L00", "L01"):
                    (folder / level).mkdir(exist_ok=True)
                    path = folder / level / f"{stage}.benchmark.tsv"
                    path.write_text("s\th:m:s\tmax_rss\n1.0\t0:00:01\t50\n")
            (folder / "transport.benchmark.tsv").write_text("s\th:m:s\n1.0\t0:00:01\n")


BENCHES = {
    "scaling": """\
scene,views,height,width,rays,tolerance,patterns,processing_s_per_image,floor_s_per_image,\
stored_mb,peak_mb
planes_iv,1,32,32,1024,0.00015,293,0.00926,0.000003,0.56,755
planes_iv,1,64,64,4096,0.00015,405,0.01159,0.000015,2.4,905
light_field,9,26,40,9360,0.002,998,0.01715,0.000030,25.7,947
""",
    "relight": """\
height,width,rays,relight_ms,batch_ms_per_pattern,copy_ms,csr_ms,dense_ms
32,32,1024,0.4,0.06,0.08,2.6,0.45
64,64,4096,0.6,0.17,0.14,,
""",
    "storage": "format,codec,bytes,error\nfloat16,zstd,1234567,1.25e-4\nfloat32,none,7654321,0\n",
    "merge": "height,width,patterns,how,ms\n310,350,240,2 threads,23.5\n",
    "patterns": """\
method,side,rays,patterns,rms_total
brute_force,8,64,64,
symmetric,8,64,53,0.00066
brute_force,16,256,256,
symmetric,16,256,145,0.00092
""",
    "workflow": """\
stage,jobs,job_s,process_s,loading_s,own_s,overhead_s
capture_simulated,32,2.61,2.28,1.34,0.94,1.67
whole run,173,2.61,1.85,1.42,0.43,2.18
""",
}


def measured(results: Path, *names: str) -> None:
    """Write what `make bench` does."""
    (results / "bench").mkdir(parents=True, exist_ok=True)
    for name in names or BENCHES:
        (results / "bench" / f"{name}.csv").write_text(BENCHES[name])
