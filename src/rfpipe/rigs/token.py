"""The secret that an acquisition server and its client share."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from rfpipe.errors import ConfigError

__all__ = ["TOKEN_VARIABLE", "read_token"]

TOKEN_VARIABLE = "RFPIPE_TOKEN"
"""Environment variable that holds the token where no file is named."""

_LEAST_CHARACTERS = 16
_MOST_CHARACTERS = 512
_ADVICE = (
    "make one with: (umask 077; python -c 'import secrets; print(secrets.token_urlsafe(32))' "
    "> rig.token)"
)


def read_token(file: Path | None = None, variable: str = TOKEN_VARIABLE) -> str:
    """Read the bearer token from a file or from the environment; never from a command line.

    Parameters
    ----------
    file : Path, optional
        Holds nothing but the token; nobody but its owner may read it.
    variable : str
        Environment variable to look into without a file.

    Returns
    -------
    str
        16 to 512 visible ASCII characters.

    Raises
    ------
    ConfigError
        When there is none, others may read the file, or the token is too short, too long or holds
        other characters. No message shows it.
    """
    if file is None:
        source, token = f"the environment variable {variable}", os.environ.get(variable, "")
        if not token:
            raise ConfigError(f"{source} is not set and no token file is named; {_ADVICE}")
    else:
        source, token = str(file), _content(file)
    is_visible = token.isascii() and all(33 <= ord(character) <= 126 for character in token)
    if not is_visible or not _LEAST_CHARACTERS <= len(token) <= _MOST_CHARACTERS:
        raise ConfigError(
            f"{source}: holds a token of {len(token)} characters; expected "
            f"{_LEAST_CHARACTERS} to {_MOST_CHARACTERS} ASCII letters, digits and signs without "
            f"spaces; {_ADVICE}"
        )
    return token


def _content(file: Path) -> str:
    try:
        with file.open(encoding="utf-8") as opened:
            mode = stat.S_IMODE(os.fstat(opened.fileno()).st_mode)
            content = opened.read(2 * _MOST_CHARACTERS)
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{file}: can't be read as a token file: {error}; {_ADVICE}") from error
    if os.name == "posix" and mode & 0o077:
        raise ConfigError(
            f"{file}: has the mode {mode:o}, so that others may read the token; run: "
            f"chmod 600 {file}"
        )
    return content.strip()
