"""Whether calibration calls healthy benches good: 20 seeds of one, and others of other kinds.

    python benchmarks/calibrate_seeds.py                  # 20 seeds of the plain bench
    python benchmarks/calibrate_seeds.py --kinds all --seeds 2

Prints a line for each step that isn't good, and a summary; the exit status says whether all were.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from rfpipe.calibration.job import calibrate_rig
from rfpipe.config import parse_rig_config

RAYS = 16

COLOUR = {
    "camera": {"options": {"pixel_format": "BayerRG12"}},
    "sensor": {"bayer": "RGGB"},
    "scene": {"channels": 3},
    "camera_shape": [80, 88],
}
EIGHT_BITS = {
    "camera": {"options": {"pixel_format": "Mono8"}},
    "sensor": {"bits": 8, "black_level_counts": 4},
}
STEEP = {"sensor": {"black_level_counts": 400}, "bench": {"camera": {"response_gamma": 2.2}}}
KINDS: dict[str, dict[str, Any]] = {
    "plain": {},
    "colour": COLOUR,
    "8 bits": EIGHT_BITS,
    "10 bits": {
        "camera": {"options": {"pixel_format": "Mono10"}},
        "sensor": {"bits": 10, "black_level_counts": 16},
    },
    "projector gamma 1": {"bench": {"projector_gamma": 1.0}},
    "projector gamma 1.8, black 0.05 %": {
        "bench": {"projector_gamma": 1.8, "projector_black": 5e-4}
    },
    "camera gamma 2.2": STEEP,
    "plane": {"scene": {"kind": "plane", "surfaces": ["texture"]}},
    "two exposures": {"sensor": {"exposures": [1 / 64, 1 / 8]}},
    "more light": {"sensor": {"exposures": [1 / 80, 1 / 20, 1 / 5]}},
    "larger": {"rays": 24, "camera_shape": [84, 92], "display_shape": [216, 240]},
    "fine pixels": {"camera_shape": [110, 120]},
    "noisy": {"bench": {"camera": {"read_noise_electrons": 15.0}}},
}
"""Healthy benches, by what they differ in."""


def settings_of(kind: str, seed: int) -> dict[str, Any]:
    """Return the settings of a bench."""
    changes = dict(KINDS[kind])
    rays = changes.pop("rays", RAYS)
    scene = {
        "kind": "wedge", "surfaces": ["white", "texture"], "shape": [rays, rays], "channels": 1,
        **changes.pop("scene", {}),
    }  # fmt: skip
    own = changes.pop("bench", {})
    camera = own.pop("camera", None) if "camera" in own else None
    sensor = changes.pop("sensor", {})
    bench = {
        "scene": scene,
        "display_shape": changes.pop("display_shape", [144, 160]),
        "camera_shape": changes.pop("camera_shape", [48, 52]),
        **own,
    }
    if camera is not None:
        bench["camera"] = {**sensor, **camera}
    return {
        "rays": [rays, rays],
        "projector": {"options": {"settle_seconds": 0.0}},
        "sensor": sensor,
        "bench": bench,
        "seed": seed,
        "calibrate": {"dark_frames": 4, "levels": 6, "codes": 17, "symmetry_patterns": 6},
        **changes,
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=20, help="seeds of each kind; 20")
    parser.add_argument(
        "--kinds", nargs="+", default=["plain"], help=f"all, or of: {', '.join(KINDS)}"
    )
    arguments = parser.parse_args()
    kinds = list(KINDS) if arguments.kinds == ["all"] else arguments.kinds
    bad = count = 0
    for kind in kinds:
        for seed in range(arguments.seeds):
            begun = time.perf_counter()
            with tempfile.TemporaryDirectory() as folder:
                config = parse_rig_config(settings_of(kind, seed), kind)
                verdicts = calibrate_rig(config, Path(folder)).verdicts()
            others = {name: one for name, one in verdicts.items() if one["standing"] != "good"}
            count += 1
            bad += bool(others)
            took = time.perf_counter() - begun
            print(f"{kind}, seed {seed}: {len(verdicts) - len(others)} good, {took:.0f} s")
            for name, one in others.items():
                print(f"    {name}: {one['standing']}. {one['verdict']}")
            sys.stdout.flush()
    print(f"{count - bad} of {count} benches are good in all steps")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
