"""Writing into a bucket of an object store: each object whole or not at all, as S3 has it."""

from __future__ import annotations

import logging
import mimetypes
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from typing import Any

from rfpipe.config.addresses import check_bucket
from rfpipe.errors import InputError, StoreError
from rfpipe.store.remote import CREDENTIALS, connect, reason_of

__all__ = ["Bucket"]

# How long a request that fails is repeated by obstore, and how often a whole upload is begun anew.
_RETRIES: dict[str, Any] = {"max_retries": 5, "retry_timeout": timedelta(seconds=60)}
_ATTEMPTS, _SECONDS_BETWEEN = 3, 5.0
# A part of a large object is sent in one request; two at once within the time that one may take
# need 90 kB/s.
_PART_BYTES, _PARTS_AT_ONCE = 5 * 2**20, 2
_CLIENT: dict[str, Any] = {"timeout": timedelta(seconds=120), "connect_timeout": "10s"}

_log = logging.getLogger(__name__)


class Bucket:
    """A folder in a bucket that is read and written.

    Credentials, region and endpoint come from the environment: ``AWS_ACCESS_KEY_ID``,
    ``AWS_SECRET_ACCESS_KEY``, ``AWS_SESSION_TOKEN``, ``AWS_REGION``, ``AWS_ENDPOINT_URL``.

    Parameters
    ----------
    address : str
        ``s3://bucket/folder``.

    Raises
    ------
    InputError
        When it is no such address, or the environment has no credentials.
    StoreError
        When obstore isn't installed.
    """

    def __init__(self, address: str) -> None:
        try:
            check_bucket(address)
        except ValueError as error:
            raise InputError(f"{address}: {error}") from None
        if not any(os.environ.get(name) for name in CREDENTIALS):
            raise InputError(
                f"{address}: the environment has no credentials to write there; set "
                "AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, and AWS_ENDPOINT_URL for a server "
                "other than Amazon's"
            )
        self._store, self._folder, self._root = connect(address, retries=_RETRIES, client=_CLIENT)
        self.address = f"{self._root}/{self._folder}".rstrip("/")

    def sizes(self) -> dict[str, int]:
        """Return bytes by name of all objects in the folder.

        Raises
        ------
        StoreError
            When the bucket is missing, may not be listed, or its server doesn't answer.
        """
        with self._errors(self.address, "listed"):
            pages = self._store.list(prefix=self._folder or None)
            found = [(entry["path"], entry["size"]) for page in pages for entry in page]
        start = f"{self._folder}/" if self._folder else ""
        return {path.removeprefix(start): size for path, size in found}

    def read(self, name: str) -> bytes | None:
        """Return a small object, None where there is none; errors as `sizes`."""
        with self._errors(f"{self.address}/{name}", "read"):
            try:
                return bytes(self._store.get(self._key(name)).bytes())
            except FileNotFoundError:
                return None

    def put(self, name: str, content: Path | bytes) -> None:
        """Write an object, which takes the place of an older one once it is whole.

        What the connection breaks is sent again.

        Raises
        ------
        StoreError
            As `sizes`, or when it may not be written.
        """
        kind = mimetypes.guess_type(name)[0] or "application/octet-stream"
        for attempt in range(1, _ATTEMPTS + 1):
            try:
                with self._errors(f"{self.address}/{name}", "written"):
                    self._store.put(
                        self._key(name),
                        content,
                        attributes={"Content-Type": kind},
                        chunk_size=_PART_BYTES,
                        max_concurrency=_PARTS_AT_ONCE,
                    )
                return
            except _BrokenError as error:
                if attempt == _ATTEMPTS:
                    raise StoreError(str(error)) from None
                _log.warning("%s; sent again", error)
                time.sleep(attempt * _SECONDS_BETWEEN)

    def _key(self, name: str) -> str:
        return f"{self._folder}/{name}" if self._folder else name

    @contextmanager
    def _errors(self, place: str, done: str) -> Iterator[None]:
        """Turn what obstore raises into a StoreError of one line; FileNotFoundError passes."""
        from obstore.exceptions import (
            BaseError,
            NotFoundError,
            PermissionDeniedError,
            UnauthenticatedError,
        )

        try:
            yield
        except (PermissionDeniedError, UnauthenticatedError) as error:
            raise StoreError(
                f"{place}: can't be {done}: {reason_of(error)}; check the credentials of the "
                "environment and their rights to list, read and write there"
            ) from None
        except (BaseError, FileNotFoundError) as error:
            if "NoSuchBucket" in str(error):
                raise StoreError(
                    f"{place}: can't be {done}: there is no such bucket; make it, or check the "
                    "address and AWS_ENDPOINT_URL"
                ) from None
            if isinstance(error, NotFoundError | FileNotFoundError):
                raise FileNotFoundError(place) from None
            raise _BrokenError(
                f"{place}: can't be {done}: {reason_of(error)}; check the network and "
                "AWS_ENDPOINT_URL, then run again: it goes on where it stopped"
            ) from None


class _BrokenError(StoreError):
    """What a second attempt may mend."""
