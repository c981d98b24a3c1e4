"""Errors that rfpipe raises on purpose; any other exception that leaves the library is a bug.

An error has four fields: what is wrong, the value, the place (a file, a setting, a pattern), and
the remedy. Callers that need to distinguish errors test their class or fields, never the message.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

_USER_OF_URL = re.compile(r"(:/+)[^/\s'\"]*@")
"""User name and password of a URL; a Path made from a URL has a single slash before them."""


class RfpipeError(Exception):
    """Base class of the errors that rfpipe raises on purpose.

    The message reads ``what: value (place); remedy``, without the fields that aren't given. User
    names and passwords in URLs are removed from it.

    Parameters
    ----------
    what : object
        Description of what is wrong, without a full stop. A message that already names value and
        place needs no other field.
    value : object, optional
        The offending value; a string is shown in quotes.
    place : object, optional
        File, setting, pattern or device that is affected.
    remedy : str
        What the user can do. A remedy that begins with a capital letter becomes a sentence of its
        own; any other follows a semicolon.

    Attributes
    ----------
    what, remedy : str
        The parameters, without user names and passwords.
    value, place : object
        The parameters, strings without user names and passwords; None where not given.

    Examples
    --------
    >>> str(RfpipeError("unknown method", value="symetric", place="config.yaml", remedy="fix it"))
    "unknown method: 'symetric' (config.yaml); fix it"
    """

    def __init__(
        self, what: object = "", *, value: object = None, place: object = None, remedy: str = ""
    ) -> None:
        self.what = _without_user(what)
        self.value = _without_user(value) if isinstance(value, str) else value
        self.place = _without_user(place) if isinstance(place, str) else place
        self.remedy = _without_user(remedy)
        super().__init__(str(self))

    @property
    def problem(self) -> str:
        """The message without the remedy."""
        text = self.what
        if self.value is not None:
            value = repr(self.value) if isinstance(self.value, str) else self.value
            text = f"{text}: {value}"
        if self.place is not None:
            text = f"{text} ({self.place})"
        return _without_user(text)

    def __str__(self) -> str:
        if not self.remedy:
            return self.problem
        if not self.remedy[0].isupper():
            return f"{self.problem}; {self.remedy}"
        end = "" if self.problem.endswith((".", "?")) else "."
        return f"{self.problem}{end} {self.remedy}"

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the class with all fields, for errors raised in worker processes."""
        return _restore, (type(self), self.args, self.__dict__)


def _without_user(text: object) -> str:
    return _USER_OF_URL.sub(r"\1", str(text))


def _restore(kind: type[RfpipeError], args: tuple[Any, ...], fields: dict[str, Any]) -> RfpipeError:
    error = kind.__new__(kind, *args)
    error.__dict__.update(fields)
    return error


class ConfigError(RfpipeError):
    """A configuration file is unreadable, or a setting in it is unknown or out of range."""


class InputError(RfpipeError, ValueError):
    """An argument has the wrong shape, dtype, range or kind."""


class UnsuitableValueError(ValueError):
    """The value of a setting is unsuitable; the message completes "it should ..."."""


class CaptureError(RfpipeError):
    """A rig failed, or the picture it returned can't belong to the displayed pattern."""


class PicturesNeeded(CaptureError):  # noqa: N818 - a request, not a failure
    """An offline rig waits for pictures that have not been taken yet."""


class VerificationError(RfpipeError):
    """The error of a transport in its verification pictures exceeds the accepted error."""


class ClusterError(RfpipeError):
    """The cluster doesn't answer, is unsuitable for the job, or lost it."""


class StoreError(RfpipeError):
    """A store, journal or manifest is missing, unreadable or can't be written."""


class UnreachableError(StoreError):
    """A server doesn't answer or its answer breaks off, so the state of its files is unknown."""


class IntegrityError(StoreError):
    """Stored bytes differ from the digest that was recorded when they were written."""


class IncompleteError(StoreError):
    """A store of frames is not finished; its capture was interrupted."""


class DamagedStageError(IntegrityError):
    """The store of a stage is damaged or missing; the stage has to run again.

    Parameters
    ----------
    what, value, place, remedy
        As for `RfpipeError`.
    manifest : Path
        Manifest of the stage; the stage runs again once it is removed.
    """

    def __init__(
        self,
        what: object,
        *,
        manifest: Path,
        value: object = None,
        place: object = None,
        remedy: str = "",
    ) -> None:
        super().__init__(what, value=value, place=place, remedy=remedy)
        self.manifest = manifest


class StaleStoreError(StoreError):
    """A store was made with another configuration than the current one."""


class LockedError(StoreError):
    """Another process holds the lock of this store."""


class TransferError(RfpipeError):
    """A message between the acquisition server and its client is malformed or damaged."""
