"""The programs that published runs are checked by, in an environment of their own."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

_PYTHON = Path(__file__).parents[1] / ".venv-validators" / "bin" / "python"


def validators_python() -> str:
    """Return the interpreter that has them; skip a test without it, or fail where required."""
    if not _PYTHON.exists():
        if os.environ.get("RFPIPE_REQUIRE_VALIDATORS"):
            pytest.fail("RFPIPE_REQUIRE_VALIDATORS is set, but there are none: make validators")
        pytest.skip("a test by programs of other projects; to install them: make validators")
    return str(_PYTHON)
