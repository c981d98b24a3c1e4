"""Objects behind an address, http(s) or S3, through obstore: read by ranges, written whole."""

from __future__ import annotations

import base64
import io
import logging
import mimetypes
import os
import re
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import timedelta
from pathlib import Path
from typing import IO, Any, cast
from urllib.parse import SplitResult, unquote, urlsplit

from rfpipe.config.addresses import check_bucket
from rfpipe.errors import InputError, StoreError, UnreachableError, installing
from rfpipe.store.places import Place, Range

# However slow a line is, it is waited for while bytes come, at most a day; one that stalls is
# asked once more.
_READING: dict[str, Any] = {"timeout": timedelta(days=1), "read_timeout": timedelta(seconds=30)}
# A part of a large object is sent in one request; two at once within the time that one may take
# need 90 kB/s.
_WRITING: dict[str, Any] = {"timeout": timedelta(seconds=120), "connect_timeout": "10s"}
_PART_BYTES, _PARTS_AT_ONCE = 5 * 2**20, 2
_RETRIES: dict[str, Any] = {"max_retries": 4, "retry_timeout": timedelta(seconds=60)}
# How often a whole upload is begun anew, and after how long.
_ATTEMPTS, _SECONDS_BETWEEN = 3, 5.0
# Of a zip file's end: the directory of some thousand files, and the metadata written before it.
_TAIL_BYTES = 256 * 2**10
# A request takes as long as half a MB on a usual line, so that reading on costs little.
_AHEAD_BYTES = 256 * 2**10
# What lies between two parts that are wanted and is fetched with them rather than asked twice.
_BETWEEN_BYTES = 32 * 2**10
_MESSAGE = re.compile(r"(\d{3} [A-Za-z ]+): .*<Message>(.*?)</Message>")  # of S3's servers
_ENDPOINTS = ("AWS_ENDPOINT_URL", "AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT")
_BUCKET = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")
# Without these, requests to S3 go unsigned, as public buckets take them.
_CREDENTIALS = (
    "AWS_ACCESS_KEY_ID",
    "AWS_WEB_IDENTITY_TOKEN_FILE",
    "AWS_CONTAINER_CREDENTIALS_RELATIVE_URI",
    "AWS_CONTAINER_CREDENTIALS_FULL_URI",
)

_log = logging.getLogger(__name__)


class ObjectPlace(Place):
    """A folder or file behind an address, each file an object of its own.

    Parameters
    ----------
    store
        Of obstore; its root is the server or the bucket.
    key : str
    root : str
        The store's address, for messages.
    """

    def __init__(self, store: Any, key: str, root: str) -> None:
        super().__init__(key)
        self._store, self._root = store, root

    @classmethod
    def of(cls, address: str) -> ObjectPlace:
        """Return the place of an address; InputError where it is of another kind."""
        return cls(*_connect(address, _READING))

    def __str__(self) -> str:
        key = self.key
        if not self._is_s3:  # can be copied into another program
            key = key.replace("%", "%25").replace("?", "%3F").replace("#", "%23")
        return f"{self._root}/{key}".rstrip("/")

    def at(self, key: str) -> ObjectPlace:
        return ObjectPlace(self._store, key, self._root)

    def read_bytes(self) -> bytes:
        with _errors(str(self)):
            return bytes(self._store.get(self.key).bytes())

    def read_ranges(self, ranges: Sequence[Range]) -> list[bytes]:
        parts: list[bytes] = []
        with _errors(str(self)):
            if all(start >= 0 and stop is not None for start, stop in ranges) and ranges:
                starts, ends = zip(*ranges, strict=True)
                found = self._store.get_ranges(
                    self.key, starts=starts, ends=ends, coalesce=_BETWEEN_BYTES
                )
                return [bytes(part) for part in found]
            for start, stop in ranges:
                if stop is not None or not start:
                    return super().read_ranges(ranges)
                wanted = {"suffix": -start} if start < 0 else {"offset": start}
                parts.append(bytes(self._store.get(self.key, options={"range": wanted}).bytes()))
        return parts

    def end(self) -> tuple[bytes, int]:
        """Return the last bytes of a file, and its size."""
        try:
            with _errors(str(self)):
                found = self._store.get(self.key, options={"range": {"suffix": _TAIL_BYTES}})
                return bytes(found.bytes()), int(found.meta["size"])
        except UnreachableError:
            with suppress(Exception):  # the first error tells more
                if self._store.head(self.key)["size"] == 0:  # no range could be asked for
                    return b"", 0
            raise

    def open(self) -> IO[bytes]:
        """Open a file, to be read by ranges."""
        return cast(IO[bytes], io.BufferedReader(_Ranged(self), _AHEAD_BYTES))

    def files(self) -> list[str]:
        if not self._is_s3:
            raise StoreError(
                f"{self}: a web server doesn't list its files; give the address of a "
                "transport.zarr, of a .zip, or of a folder that 'rfpipe publish' made"
            )
        return sorted(self.sizes())

    def nbytes(self) -> int | None:
        return sum(self.sizes().values()) if self._is_s3 else None

    def sizes(self) -> dict[str, int]:
        """Return the bytes of all objects in a bucket's folder, by name."""
        start = f"{self.key}/" if self.key else ""
        with _errors(str(self), "listed"):
            pages = self._store.list(prefix=self.key or None)
            return {
                entry["path"].removeprefix(start): entry["size"] for page in pages for entry in page
            }

    @property
    def _is_s3(self) -> bool:
        return self._root.startswith("s3:")


class Bucket(ObjectPlace):
    """A folder in a bucket, ``s3://bucket/folder``, that is written, too.

    Credentials, region and endpoint come from the environment: ``AWS_ACCESS_KEY_ID``,
    ``AWS_SECRET_ACCESS_KEY``, ``AWS_SESSION_TOKEN``, ``AWS_REGION``, ``AWS_ENDPOINT_URL``.

    Raises
    ------
    InputError
        When it is no such address, or the environment has no credentials.
    """

    def __init__(self, address: str) -> None:
        try:
            check_bucket(address)
        except ValueError as error:
            raise InputError(f"{address}: {error}") from None
        if not any(os.environ.get(name) for name in _CREDENTIALS):
            raise InputError(
                f"{address}: the environment has no credentials to write there; set "
                "AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, and AWS_ENDPOINT_URL for a server "
                "other than Amazon's"
            )
        super().__init__(*_connect(address, _WRITING))

    def put(self, name: str, content: Path | bytes) -> None:
        """Write an object, which replaces an older one once it is whole.

        What the connection breaks is sent again.

        Raises
        ------
        StoreError
            When the bucket is missing or may not be written, or its server doesn't answer.
        """
        place = self / name
        kind = mimetypes.guess_type(name)[0] or "application/octet-stream"
        for attempt in range(1, _ATTEMPTS + 1):
            try:
                with _errors(str(place), "written"):
                    self._store.put(
                        place.key,
                        content,
                        attributes={"Content-Type": kind},
                        chunk_size=_PART_BYTES,
                        max_concurrency=_PARTS_AT_ONCE,
                    )
                return
            except UnreachableError as error:
                if attempt == _ATTEMPTS:
                    raise
                _log.warning("%s; sent again", error)
                time.sleep(attempt * _SECONDS_BETWEEN)

    def at(self, key: str) -> ObjectPlace:
        return ObjectPlace(self._store, key, self._root)


class _Ranged(io.RawIOBase):
    """A file behind an address; its end, a zip file's directory, comes with the first request."""

    def __init__(self, place: ObjectPlace) -> None:
        self._place = place
        self._tail, self._size = place.end()
        self._position = 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def tell(self) -> int:
        return self._position

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        base = {io.SEEK_SET: 0, io.SEEK_CUR: self._position, io.SEEK_END: self._size}[whence]
        if base + offset < 0:
            raise OSError(f"{self._place}: no place {base + offset} in a file")
        self._position = base + offset
        return self._position

    def readinto(self, buffer: Any) -> int:
        start, stop = self._position, min(self._position + len(buffer), self._size)
        if stop <= start:
            return 0
        tail = self._size - len(self._tail)
        content = self._tail[start - tail : stop - tail] if start >= tail else b""
        if start < tail:
            stop = min(stop, tail)
            content = self._place.read_ranges([(start, stop)])[0]
        buffer[: len(content)] = content
        self._position += len(content)
        return len(content)


def _connect(address: str, client: dict[str, Any]) -> tuple[Any, str, str]:
    """Return the obstore store of an address's server or bucket, the key in it, and its root."""
    parts = _checked(address)
    try:
        from obstore.exceptions import BaseError
        from obstore.store import HTTPStore, S3Store
    except ImportError as error:
        raise StoreError(
            f"{address}: to read behind an address needs the extra publish; download it, or "
            f"{installing('publish')}"
        ) from error
    host = parts.netloc.rpartition("@")[2]
    root = f"{parts.scheme}://{host}"
    options: dict[str, Any] = {"allow_http": True, **client}
    try:
        if parts.scheme == "s3":
            signed = any(os.environ.get(name) for name in _CREDENTIALS)
            unsigned: Any = {} if signed else {"skip_signature": True}
            bucket: Any = S3Store(
                host,
                client_options=cast(Any, options),
                retry_config=cast(Any, _RETRIES),
                **unsigned,
            )
            return bucket, parts.path.strip("/"), root
        if parts.username is not None:  # which obstore leaves out
            user = f"{unquote(parts.username)}:{unquote(parts.password or '')}"
            encoded = base64.b64encode(user.encode()).decode()
            options["default_headers"] = {"Authorization": f"Basic {encoded}"}
        server = HTTPStore.from_url(
            f"{root}/", client_options=cast(Any, options), retry_config=cast(Any, _RETRIES)
        )
    except (ValueError, BaseError) as error:
        raise InputError(
            f"{address}: can't be opened: {_reason(error)}; check the address"
            + (" and the environment's AWS_..." if parts.scheme == "s3" else "")
        ) from None
    return server, unquote(parts.path).strip("/"), root


def _checked(address: str) -> SplitResult:
    """Return the parts of an address; InputError where it, or the environment, is wrong."""
    try:
        parts = _split(address, ("http", "https", "s3"))
        if parts.scheme == "s3":
            if parts.username is not None:
                raise ValueError(
                    "names a user; give credentials as AWS_ACCESS_KEY_ID and "
                    "AWS_SECRET_ACCESS_KEY in the environment"
                )
            if not _BUCKET.fullmatch(parts.netloc):  # which obstore dies of, as of a wrong endpoint
                raise ValueError(f"{parts.netloc!r} can't be a bucket")
            for name in filter(os.environ.__contains__, _ENDPOINTS):
                try:
                    _split(os.environ[name], ("http", "https"))
                except ValueError:
                    raise ValueError(
                        f"the environment's {name} is {os.environ[name]!r}; expected the server's "
                        "address, such as https://objects.example.org, or none for Amazon's"
                    ) from None
    except ValueError as error:
        raise InputError(f"{address}: {error}") from None
    return parts


def _split(address: str, schemes: tuple[str, ...]) -> SplitResult:
    parts = urlsplit(address)
    scheme, port = parts.scheme.lower(), parts.port
    if scheme not in schemes or not parts.hostname or port == 0 or parts.query or parts.fragment:
        raise ValueError(
            "expected http://, https:// or s3:// with a host or bucket and a path, and without '?' "
            "or '#'"
        )
    return parts._replace(scheme=scheme)


@contextmanager
def _errors(place: str, action: str = "read") -> Iterator[None]:
    """Turn what obstore raises into a StoreError of one line; FileNotFoundError passes."""
    from obstore.exceptions import (
        BaseError,
        NotSupportedError,
        PermissionDeniedError,
        UnauthenticatedError,
    )

    is_s3 = place.startswith("s3:")
    what = "the credentials of the environment and AWS_ENDPOINT_URL" if is_s3 else "the address"
    # none of them chained: obstore's own message shows the address as it was given
    try:
        yield
    except NotSupportedError as error:
        raise StoreError(
            f"{place}: can't be read: {_reason(error)}; its server doesn't answer range requests, "
            "or answers a page of its own, such as one to log in: check the address, or download "
            "it and open the file"
        ) from None
    except (PermissionDeniedError, UnauthenticatedError) as error:
        raise StoreError(
            f"{place}: can't be {action}: {_reason(error)}; check {what} and who may read it"
        ) from None
    except (BaseError, FileNotFoundError) as error:
        if "NoSuchBucket" in str(error):
            raise StoreError(
                f"{place}: can't be {action}: there is no such bucket; make it, or check the "
                "address and AWS_ENDPOINT_URL"
            ) from None
        if isinstance(error, FileNotFoundError):
            raise FileNotFoundError(place) from None
        raise UnreachableError(
            f"{place}: can't be {action}: {_reason(error)}; check the network and {what}, then run "
            "again: an upload goes on where it stopped"
        ) from None


def _reason(error: Exception) -> str:
    """Return what obstore or the server says is wrong, in one line."""
    said = " ".join(str(error).partition("\n\nDebug source")[0].split())
    message = _MESSAGE.search(said)
    return f"{message[1]}: {message[2]}" if message else said
