"""Pythons of this machine on which a release is tried."""

from __future__ import annotations

import os
import sys
from pathlib import Path

OLDEST, NEWEST = 11, 13
"""Minor versions of Python that rfpipe supports."""


def installed_pythons() -> dict[str, Path]:
    """Return the interpreters of the supported versions, such as ``3.12``.

    They are those on the search path, of pyenv and of uv, and the one that runs the tests.
    """
    interpreters = {f"3.{sys.version_info.minor}": Path(sys.executable)}
    pyenv = Path(os.environ.get("PYENV_ROOT") or "~/.pyenv").expanduser() / "versions"
    uv = Path(os.environ.get("UV_PYTHON_INSTALL_DIR") or "~/.local/share/uv/python").expanduser()
    for minor in range(OLDEST, NEWEST + 1):
        name = f"python3.{minor}"
        candidates = [
            *(Path(folder, name) for folder in os.get_exec_path() if Path(folder).name != "shims"),
            *pyenv.glob(f"3.{minor}.*/bin/{name}"),
            *uv.glob(f"cpython-3.{minor}.*/bin/{name}"),
        ]
        usable = [path for path in candidates if os.access(path, os.X_OK)]
        if usable:
            interpreters.setdefault(f"3.{minor}", usable[0])
    return dict(sorted(interpreters.items()))
