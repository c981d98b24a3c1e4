"""A folder for the caches of libraries where the user's own can't be written.

Snakemake and Numba fail, and Matplotlib warns, where the home folder can't be written or does not
exist, as in containers that run under a number without an account. Their caches only save time.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path

_CACHE, _CONFIG, _MATPLOTLIB = "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "MPLCONFIGDIR"


def ensure_cache_folders() -> None:
    """Set environment variables so that libraries of this process and its children have caches.

    Nothing is set where the user's folders can be written. Else the caches are in a private folder
    for temporary files.
    """
    if not hasattr(os, "getuid"):  # Windows, where libraries don't use these variables
        return
    has_cache = _is_usable(os.environ.get(_CACHE) or "~/.cache")
    has_config = _is_usable(os.environ.get(_CONFIG) or "~/.config")
    if has_cache and (has_config or _MATPLOTLIB in os.environ):
        return
    try:
        folder = _private_folder()
    except OSError:  # no place for temporary files either: libraries report it
        return
    if not has_cache:
        os.environ[_CACHE] = str(folder)
    if not has_config:
        os.environ.setdefault(_MATPLOTLIB, str(folder / "matplotlib"))


def _is_usable(name: str) -> bool:
    """Test whether a folder can be written, or created."""
    try:
        path = Path(name).expanduser()
        place = next(place for place in (path, *path.parents) if place.exists())
    except (OSError, RuntimeError, StopIteration):  # such as a user without an account
        return False
    return place.is_dir() and os.access(place, os.W_OK | os.X_OK)


def _private_folder() -> Path:
    """Folder that no other user can write: caches contain code, which libraries run."""
    import tempfile

    folder = Path(tempfile.gettempdir(), f"rfpipe-cache-{os.getuid()}")
    try:
        folder.mkdir(0o700)
    except FileExistsError:
        state = folder.lstat()
        is_private = stat.S_ISDIR(state.st_mode) and not state.st_mode & 0o077
        if not is_private or state.st_uid != os.getuid():
            return Path(tempfile.mkdtemp(prefix="rfpipe-cache-"))
    return folder
