"""Patterns against rays for each method, exact radiance [Fig. 3.8]: results/bench/patterns.csv.

Usage: ``python benchmarks/bench_patterns.py``. The report's study of resolutions, at finer ones.
"""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from rfpipe.config import Config
from rfpipe.stages.evaluating.studies.resolution import resolution_study

OUTPUT = Path("results/bench/patterns.csv")
SIDES = (8, 16, 32, 64, 128)


def main() -> None:
    """Run the study."""
    config = Config.model_validate(
        {
            "scenes": {"iv": {"kind": "wedge", "surfaces": ["texture", "texture"]}},
            "camera": None,
            "methods": {"dual": {}, "symmetric": {}},
            "report": {"resolutions": SIDES},
        }
    )
    table = pd.DataFrame(resolution_study(config))
    OUTPUT.parent.mkdir(parents=True, exist_ok=True)
    table.to_csv(OUTPUT, index=False, float_format="%.4g")
    print(table.pivot_table(index="rays", columns="method", values="patterns").to_string())


if __name__ == "__main__":
    main()
