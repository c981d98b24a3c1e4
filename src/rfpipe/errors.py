"""The errors that rfpipe raises on purpose.

Every message names the file or setting, its value, what was expected and what to do. Anything
else that escapes the library is a bug.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

# what a URL has between its slashes and its host: a user's name, and a password behind it; a Path
# that was made of a URL has one slash
_USER = re.compile(r"(:/+)[^/\s'\"]*@")


def installing(extra: str) -> str:
    """Return how to install an extra of rfpipe, for the end of a message.

    From a clone, as long as no package index has it: there, another program is called rfpipe.
    """
    return f"run pip install '.[{extra}]' in your clone of rfpipe"


class RfpipeError(Exception):
    """Base of every error that rfpipe raises on purpose; its message shows no password of a URL.

    Parameters
    ----------
    *args
        The message.
    advice : str
        Remedy, the end of the message; a sentence of its own where it begins with a capital letter.

    Attributes
    ----------
    fault : str
        The message without the advice.
    """

    def __init__(self, *args: object, advice: str = "") -> None:
        shown = [_USER.sub(r"\1", a) if isinstance(a, str) else a for a in args]
        self.fault = str(shown[0]) if shown else ""
        if advice:
            shown[:1] = [f"{self.fault}{'. ' if advice[0].isupper() else '; '}{advice}"]
        super().__init__(*shown)


class ConfigError(RfpipeError):
    """A configuration file is unreadable, or a setting in it is unknown or out of range."""


class InputError(RfpipeError, ValueError):
    """An argument has the wrong shape, dtype, range or kind."""


class CaptureError(RfpipeError):
    """A rig failed, or what it returned can't be a picture of the pattern shown."""


class PicturesNeeded(CaptureError):  # noqa: N818 - no failure: somebody is to take them
    """A rig whose pictures are taken elsewhere waits for those of some patterns."""


class VerificationError(RfpipeError):
    """A transport is further from the pictures taken to verify it than was accepted."""


class ClusterError(RfpipeError):
    """The cluster that was to do the work doesn't answer, isn't fit for it, or lost it."""


class StoreError(RfpipeError):
    """A store, journal or manifest is missing, unreadable or can't be written."""


class UnreachableError(StoreError):
    """A server doesn't answer, fails or breaks off: nothing is known of what it has."""


class IntegrityError(StoreError):
    """Stored bytes differ from the digest that was recorded when they were written."""


class DamagedStageError(IntegrityError):
    """What a stage left is damaged or missing; it is made anew where its manifest is missing.

    Attributes
    ----------
    manifest : Path
        The stage's.
    """

    def __init__(self, message: str, manifest: Path) -> None:
        super().__init__(message)
        self.manifest = manifest

    def __reduce__(self) -> tuple[type[DamagedStageError], tuple[str, Path]]:
        """Let another process have it."""
        return type(self), (str(self), self.manifest)


class StaleStoreError(StoreError):
    """A store was made with another configuration than the one in force."""


class LockedError(StoreError):
    """Another process holds the lock of this store."""


class TransferError(RfpipeError):
    """A message between the acquisition server and its client is malformed or damaged."""
