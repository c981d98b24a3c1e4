"""The folder of the workflow, and remedies for optional packages that aren't installed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rfpipe.errors import InputError, RfpipeError

_PACKAGE = Path(__file__).parent
_IN_PACKAGE = _PACKAGE / "_workflow"
"""Folder of the workflow in a wheel; a clone doesn't have it."""

DISTRIBUTION = "reflectance-fields"
"""Name of the installed package; on the package index, rfpipe is another program."""


def workflow_folder() -> Path:
    """Return the folder with the Snakefile: the clone of rfpipe, or a folder of the package."""
    return _IN_PACKAGE if _IN_PACKAGE.is_dir() else _PACKAGE.parents[1]


def installing(extra: str) -> str:
    """Return the remedy for a missing extra of rfpipe, with quotes that every shell accepts.

    Where rfpipe is installed, pip installs only the packages of the extra.
    """
    if _IN_PACKAGE.is_dir():
        return f'run pip install "{DISTRIBUTION}[{extra}]"'
    return f'run pip install --editable ".[{extra}]" in {workflow_folder()}'


@contextmanager
def needing(extra: str, user: str, kind: type[RfpipeError] = InputError) -> Iterator[None]:
    """Turn an ImportError into an error that names the extra to install.

    Parameters
    ----------
    extra : str
        Extra of rfpipe with the packages that are imported.
    user : str
        Description of what needs them, such as "rfpipe aim".
    kind : type, optional
        Class of the error.

    Raises
    ------
    RfpipeError
        Of class `kind`, when a package is missing or can't be loaded.
    """
    try:
        yield
    except ImportError as error:
        raise kind(f"{user} needs the extra {extra}: {error}", remedy=installing(extra)) from error
