"""Groups of jobs on a cluster: whether any of its nodes can run them."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Mapping

from rfpipe.errors import ConfigError

__all__ = ["check_groups", "largest_node"]

_SECONDS = 30.0


def check_groups(components: Mapping[str, int], cores: int | None) -> None:
    """Refuse groups that ask for more processors than any node of the cluster has.

    A group of Snakemake asks for as many as its jobs have side by side: one for each of its
    components, up to ``cores``. A scheduler that has no such node refuses the group, and the run
    ends.

    Parameters
    ----------
    components : mapping of str to int
        Components of each group, as ``--group-components`` gives them.
    cores : int or None
        As ``--cores`` or the profile says.

    Raises
    ------
    ConfigError
        When no node has so many.
    """
    name = max(components, key=lambda each: components[each], default=None)
    if name is None:
        return
    asked = min(components[name], cores or components[name])
    largest = largest_node() if asked > 1 else None
    if largest is not None and asked > largest:
        raise ConfigError(
            f"group-components: {name}={components[name]} jobs side by side ask for {asked} "
            f"processors of one node (cores: {cores or 'all'}); the largest node that sinfo lists "
            f"has {largest}. Add --cores {largest}: the jobs of a group then run "
            f"{'one after the other' if largest == 1 else f'{largest} at a time'}"
        )


def largest_node() -> int | None:
    """Return the processors of the largest node of a Slurm cluster, None where that isn't known."""
    program = shutil.which("sinfo")
    if program is None:
        return None
    try:
        told = subprocess.run(
            [program, "--noheader", "--format=%c"],
            capture_output=True, text=True, timeout=_SECONDS, check=True,
        ).stdout  # fmt: skip
    except (OSError, subprocess.SubprocessError):
        return None
    # of nodes that differ sinfo lists the least, as in 16+
    counts = [line.strip() for line in told.splitlines()]
    if not counts or any(not count.isdecimal() for count in counts):
        return None
    return max(map(int, counts))
