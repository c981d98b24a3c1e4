"""Libraries of the system that are hidden are found by no test, nor by what it starts."""

import os
import subprocess
import sys
from pathlib import Path

CODE = """
import shutil
from tests import needs
from rfpipe_mitsuba.variant import usable_llvm

links = needs.hide()
print(shutil.which("Xvfb"), usable_llvm())
print(shutil.which("other"))
"""


def test_what_is_hidden_is_not_found_and_all_else_is(tmp_path: Path) -> None:
    for name in ("Xvfb", "other"):
        (tmp_path / name).touch(0o755)
    environment = {
        "PATH": f"{tmp_path}:{os.environ['PATH']}", "RFPIPE_SYSTEM_LIBRARIES": "hidden"
    }  # fmt: skip
    told = subprocess.run(
        [sys.executable, "-c", CODE],
        cwd=Path(__file__).parents[2],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=True,
    ).stdout.splitlines()
    assert told[0] == "None None"
    assert Path(told[1]).name == "other"
    assert not Path(told[1]).exists()  # the folder of links goes with the process
