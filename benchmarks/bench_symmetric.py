"""Profile one symmetric acquisition: where the processing goes, the simulation apart.

Usage: ``python benchmarks/bench_symmetric.py [HEIGHT WIDTH [SCENE]]``, by default the thesis' size
310 x 350 and scene IV. Writes results/bench/symmetric.csv and symmetric_profile.csv.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import pandas as pd

import rfpipe
from rfpipe.methods import states
from rfpipe.methods.symmetric import method as symmetric
from rfpipe.methods.symmetric import nodes, pieces
from rfpipe.methods.symmetric import rank_k as nystroem
from rfpipe.methods.symmetric import rank_test as verdicts
from rfpipe.patterns import Schedule
from rfpipe.photometry import CameraModel
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes import reference_scene
from rfpipe.stages import acquire
from rfpipe.stages import normalize as images
from rfpipe.stages.merger import LevelSum, Merger
from rfpipe.transport.hierarchical import partition

OUTPUT = Path("results/bench")

SIMULATION, REST = "simulated capture", "everything else"

# The steps and the functions that do them, with all that these call but other steps.
STEPS: dict[str, tuple[Any, ...]] = {
    "make the patterns": (Schedule.batch,),
    SIMULATION: (SimulatedRig.capture,),
    "calibrate (black level, defects)": (Merger.calibrate,),
    "merge the brackets": (Merger.merge,),
    "add up the images": (LevelSum.add, LevelSum.join),
    "keep the images": (acquire._Session.capture,),
    "known light of the dark rays": (images.known_light,),
    "normalize": (images.normalize_level, images.NormalizedImages.read),
    "reorder to the tree": (pieces._planar,),
    "predict known light": (partition.predict,),
    "take the residual's pieces": (pieces.collect,),
    "rank test": (verdicts.rank_test,),
    "rank-k leaves": (nystroem.predictable, nystroem.rank_k_leaves),
    "make the levels agree": (verdicts.reconcile,),
    "sort the new nodes": (verdicts.classify,),
    "cut and join nodes": (
        symmetric.Symmetric.refine, nodes.select, nodes.as_leaves, states.joined,
    ),
    "schedule (conflict graph and colouring)": (symmetric.Symmetric.schedule,),
    "assemble": (symmetric.Symmetric.transport,),
}  # fmt: skip


class Stopwatch:
    """Seconds inside each step, for `sys.setprofile`; a step within a step counts for itself."""

    def __init__(self) -> None:
        self.step_of: dict[CodeType, str] = {
            function.__code__: step for step, functions in STEPS.items() for function in functions
        }
        self.seconds = dict.fromkeys([*STEPS, REST], 0.0)
        self._within = [REST]
        self._since = time.perf_counter()

    def __call__(self, frame: FrameType, event: str, _argument: Any) -> None:
        """Note that a function begins or ends."""
        step = self.step_of.get(frame.f_code)
        if step is None or event not in ("call", "return"):
            return
        now = time.perf_counter()
        self.seconds[self._within[-1]] += now - self._since
        self._since = now
        if event == "call":
            self._within.append(step)
        else:
            self._within.pop()


def main() -> None:
    """Acquire, and write both tables."""
    height, width = (int(value) for value in (*sys.argv[1:3], 310, 350)[:2])
    which = sys.argv[3] if len(sys.argv) > 3 else "IV"
    rig = SimulatedRig(reference_scene(which, (height, width), channels=3), CameraModel(), seed=1)
    # compile the kernels, which are then cached for good
    small = SimulatedRig(reference_scene(which, (12, 14), channels=3), CameraModel(), seed=1)
    rfpipe.acquire(small, progress=False)
    stopwatch = Stopwatch()
    sys.setprofile(stopwatch)
    try:
        result = rfpipe.acquire(rig, progress=True)
    finally:
        sys.setprofile(None)
    total = pd.DataFrame(
        [
            {
                "scene": which,
                "height": height,
                "width": width,
                "patterns": result.patterns,
                "simulation_s": result.capture_seconds,
                "processing_s": result.processing_seconds,
                "processing_s_per_hdr_image": result.processing_seconds / result.patterns,
                "transport_mb": result.transport.nbytes / 1e6,
            }
        ]
    )
    steps = _steps(stopwatch.seconds, result.processing_seconds)
    OUTPUT.mkdir(parents=True, exist_ok=True)
    total.to_csv(OUTPUT / "symmetric.csv", index=False, float_format="%.4g")
    steps.to_csv(OUTPUT / "symmetric_profile.csv", index=False, float_format="%.4g")
    print(total.T.to_string(header=False))
    print(steps.to_string(index=False))


def _steps(seconds: dict[str, float], processing: float) -> pd.DataFrame:
    """Make the table of steps; they and the rest add up to all processing."""
    if missing := [step for step, spent in seconds.items() if not spent]:
        raise SystemExit(f"no function was called for {missing}; has it another name now?")
    rows = [
        {"step": step, "seconds": spent, "share_of_processing": spent / processing}
        for step, spent in seconds.items()
        if step != SIMULATION
    ]
    rows.sort(key=lambda row: -row["seconds"])
    return pd.DataFrame(rows)


if __name__ == "__main__":
    main()
