"""Run commands on a full disk: ``python -m tests.services.full_disk CASES``.

CASES is JSON: a list of (largest file size in bytes, arguments of ``rfpipe``). Each command runs in
a forked process, so that libraries are loaded once, and exits as in a shell. Prints JSON: a list of
(exit status, output).
"""

from __future__ import annotations

import json
import os
import resource
import sys
from collections.abc import Sequence
from importlib import import_module

from rfpipe.cli import main

LARGEST = 2**40
LIBRARIES = ("rfpipe.export", "rfpipe.fitting", "rfpipe.publishing.publication", "rfpipe.viewer")


def ended(limit: int, arguments: Sequence[str]) -> tuple[int, str]:
    """Run a command with a limit on file sizes; return its exit status and output."""
    reading, writing = os.pipe()
    child = os.fork()
    if not child:
        os.dup2(writing, 1)
        os.dup2(writing, 2)
        os.close(writing)
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
        sys.argv = ["rfpipe", *arguments]
        main()
        sys.exit(0)
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        output = pipe.read().decode(errors="replace")
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), output


if __name__ == "__main__":
    for library in LIBRARIES:
        import_module(library)
    print(json.dumps([ended(limit, arguments) for limit, arguments in json.loads(sys.argv[1])]))
