"""Putting a scene before the rig: one of a collection after the other."""

from __future__ import annotations

import logging
import os
import shlex
import subprocess
from dataclasses import dataclass, field

from rfpipe.errors import CaptureError

__all__ = ["Placing"]

_log = logging.getLogger(__name__)


@dataclass
class Placing:
    """Has the user's command put a scene in its place, once in a job.

    Parameters
    ----------
    command : str or None
        A program and its arguments, quoted as for a shell, which isn't used. It finds
        ``RFPIPE_SCENE`` in its environment and takes as long as it takes. None does nothing.
    """

    command: str | None
    _placed: set[str] = field(default_factory=set)

    def place(self, scene: str) -> None:
        """Run the command, if it didn't run for this scene; called before patterns are shown.

        Raises
        ------
        CaptureError
            When it fails: nothing is captured then.
        """
        if not self.command or scene in self._placed:
            return
        _log.info("placing %s: %s", scene, self.command)
        try:
            environment = {**os.environ, "RFPIPE_SCENE": scene}
            subprocess.run(shlex.split(self.command), env=environment, check=True)
        except (OSError, ValueError, subprocess.SubprocessError) as error:
            raise CaptureError(
                f"{scene} was not put before the rig: capture.placing {self.command!r} failed "
                f"({error}). Nothing was captured; mend that and run again"
            ) from error
        self._placed.add(scene)
