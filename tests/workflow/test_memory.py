"""Peak memory of the stages that stream: it doesn't grow with the number of patterns."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

PROGRAM = r"""
import re, sys
from pathlib import Path

import numpy as np
import scipy.sparse

from rfpipe.patterns import Schedule
from rfpipe.photometry import CameraModel
from rfpipe.provenance import generator
from rfpipe.rigs import OperatorRig
from rfpipe.stages import capture, merge, normalize
from rfpipe.storage.files import FolderStorage
from rfpipe.stages.context import Acquisition
from rfpipe.stages.plan import Plan
from rfpipe.stages.rig_sources import GivenRig
from rfpipe.stages.settings import AcquisitionSettings
from rfpipe.storage.results import write_result
from rfpipe.jobs.workers import Resources

shape, count = (40, 50), int(sys.argv[2])
rays = shape[0] * shape[1]
folder = FolderStorage(Path(sys.argv[1]))
plan = Plan.of("brute_force", "brute_force", (shape, shape, 3))
light = scipy.sparse.identity(rays, format="csr")
rig = OperatorRig([light, 0.5 * light, 0.1 * light], shape, shape, CameraModel(), seed=1)
resources = Resources(memory_gib=0.01, threads=2)
settings = AcquisitionSettings(all_off_brackets=4, all_on_brackets=20)
acquisition = Acquisition(folder, settings, resources, GivenRig(rig), plan=plan)
for level, patterns in enumerate((1, count)):
    lit = generator(1, level).integers(0, patterns, shape).astype(np.int32)
    schedule = Schedule(level, shape, patterns, lit, complete=True)
    write_result(
        folder.manifest(level, "schedule"), "by hand",
        {"pattern_of_ray": lit},
        {
            "seed": level, "patterns": patterns, "complete": True, "shape": shape,
            "pattern_digest": schedule.digest(),
        },
    )
    capture.run(acquisition, level)
    merge.run(acquisition, level)
    normalize.run(acquisition, level)
print(re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text())[1])
"""


def peak_kib(folder: Path, patterns: int) -> int:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(folder), str(patterns)],
        check=True,
        capture_output=True,
        text=True,
        env={**os.environ, "MALLOC_ARENA_MAX": "2"},
    )
    return int(done.stdout)


def test_memory_does_not_grow_with_the_number_of_patterns(tmp_path: Path) -> None:
    peak_of_200, peak_of_2000 = peak_kib(tmp_path / "few", 200), peak_kib(tmp_path / "many", 2000)
    assert peak_of_2000 < 1.1 * peak_of_200
    stored = sum(path.stat().st_size for path in (tmp_path / "many").rglob("c*") if path.is_file())
    assert stored / 1024 > 0.4 * peak_of_200  # large enough to reveal a leak
