"""Profile one symmetric acquisition: where the processing goes, the simulation apart.

Usage: ``python benchmarks/bench_symmetric.py [HEIGHT WIDTH [SCENE]]``, by default the thesis' size
310 x 350 and scene IV. Writes results/bench/symmetric.csv and symmetric_profile.csv.
"""

from __future__ import annotations

import cProfile
import pstats
import sys
from pathlib import Path

import pandas as pd

import rfpipe
from rfpipe.photometry import CameraModel
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes import reference_scene

OUTPUT = Path("results/bench")

# The steps of the processing, by the functions that do them; the innermost one counts.
STEPS = {
    "merge the brackets": ("merging.py", "merge"),
    "normalize": ("images.py", "normalize_level"),
    "predict known light": ("hierarchical.py", "apply_leaf_sets"),
    "residual, reordering to the tree": ("residuals.py", "measure"),
    "rank test": ("symmetric.py", "_rank_test"),
    "sort the new nodes": ("symmetric.py", "_classify"),
    "schedule (conflict graph and colouring)": ("symmetric.py", "schedule"),
    "simulated capture": ("operator.py", "capture"),
}


def main() -> None:
    """Acquire, and write both tables."""
    height, width = (int(value) for value in (*sys.argv[1:3], 310, 350)[:2])
    which = sys.argv[3] if len(sys.argv) > 3 else "IV"
    rig = SimulatedRig(reference_scene(which, (height, width), channels=3), CameraModel(), seed=1)
    # compile the kernels, which are then cached for good
    small = SimulatedRig(reference_scene(which, (12, 14), channels=3), CameraModel(), seed=1)
    rfpipe.acquire(small, progress=False)
    profile = cProfile.Profile()
    result = profile.runcall(rfpipe.acquire, rig, progress=True)
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
    steps = _steps(profile, result.processing_seconds)
    OUTPUT.mkdir(parents=True, exist_ok=True)
    total.to_csv(OUTPUT / "symmetric.csv", index=False)
    steps.to_csv(OUTPUT / "symmetric_profile.csv", index=False)
    print(total.T.to_string(header=False))
    print(steps.to_string(index=False))


def _steps(profile: cProfile.Profile, processing: float) -> pd.DataFrame:
    """Sum the time inside each step."""
    seconds = dict.fromkeys(STEPS, 0.0)
    for (file, _, name), (_, _, _, cumulative, _) in pstats.Stats(profile).stats.items():
        for step, (module, function) in STEPS.items():
            if Path(file).name == module and name == function:
                seconds[step] += cumulative
    if missing := [step for step, spent in seconds.items() if not spent]:
        raise SystemExit(f"no such function was called: {missing}; has it another name now?")
    seconds["residual, reordering to the tree"] -= seconds["predict known light"]
    rows = [
        {"step": step, "seconds": spent, "share_of_processing": spent / processing}
        for step, spent in seconds.items()
        if step != "simulated capture"
    ]
    rows.sort(key=lambda row: -row["seconds"])
    return pd.DataFrame(rows)


if __name__ == "__main__":
    main()
