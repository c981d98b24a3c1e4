"""Objects on HTTP servers and in S3 buckets, through obstore: ranged reads, atomic writes."""

from __future__ import annotations

import base64
import io
import mimetypes
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from typing import IO, Any, cast
from urllib.parse import SplitResult, quote, unquote, urlsplit

from rfpipe.errors import InputError, StoreError, UnreachableError
from rfpipe.installation import needing
from rfpipe.store.places import Place, Range

# A slow download may take up to a day; one that stalls for 30 s is retried.
_READING: dict[str, Any] = {"timeout": timedelta(days=1), "read_timeout": timedelta(seconds=30)}
# Each part of a large object is one request; two concurrent parts of 5 MiB within the timeout need
# 90 kB/s.
_WRITING: dict[str, Any] = {"timeout": timedelta(seconds=120), "connect_timeout": "10s"}
_PART_BYTES, _PARTS_AT_ONCE = 5 * 2**20, 2
_RETRIES: dict[str, Any] = {"max_retries": 4, "retry_timeout": timedelta(seconds=60)}
# Size of a first read at the end of a zip file, which covers the directory of some thousand files
# and metadata, and of read-ahead: a request takes as long as transferring about half a MB.
_AHEAD_BYTES = 256 * 2**10
# Largest gap between two ranges that are fetched by one request.
_BETWEEN_BYTES = 32 * 2**10
_MESSAGE = re.compile(r"(\d{3} [A-Za-z ]+): .*<Message>(.*?)</Message>")  # errors of S3 servers
_ENDPOINTS = ("AWS_ENDPOINT_URL", "AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT")
_BUCKET = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")
# Without any of these variables, requests to S3 are unsigned, which public buckets accept.
_CREDENTIALS = re.compile(
    "AWS_(ACCESS_KEY_ID|WEB_IDENTITY_TOKEN_FILE|CONTAINER_CREDENTIALS_(RELATIVE|FULL)_URI)"
)
_DENIED = (
    "check your permissions and, for s3://, the environment variables AWS_ACCESS_KEY_ID, "
    "AWS_SECRET_ACCESS_KEY and AWS_ENDPOINT_URL"
)
_ADVICE = {
    "NoSuchBucket": "there is no such bucket; create it, or check the address and AWS_ENDPOINT_URL",
    "NotSupportedError": "the server doesn't support range requests, or returns another page, "
    "such as a login page: check the address, or download the file and open it",
    "PermissionDeniedError": _DENIED,
    "UnauthenticatedError": _DENIED,
}
_WITHOUT_NETWORK = (
    "check the network, the address and, for s3://, AWS_ENDPOINT_URL, then run again: an upload "
    "continues where it stopped"
)


class ObjectPlace(Place):
    """A folder or file in an obstore store whose address is `root`."""

    def __init__(self, store: Any, key: str, root: str) -> None:
        super().__init__(key)
        self._store, self._root = store, root

    @classmethod
    def of(cls, address: str) -> ObjectPlace:
        """Connect to an address; InputError for an unsupported scheme."""
        return cls(*_connect(address, _READING))

    def __str__(self) -> str:
        # a valid address for copying
        return f"{self._root}/{self.key if self._is_s3 else quote(self.key)}".rstrip("/")

    def at(self, key: str) -> ObjectPlace:
        return ObjectPlace(self._store, key, self._root)

    def read_bytes(self) -> bytes:
        with _errors(str(self)):
            return bytes(self._store.get(self.key).bytes())

    def read_ranges(self, ranges: Sequence[Range]) -> list[bytes]:
        starts, ends = zip(*ranges, strict=True) if ranges else ((), ())
        with _errors(str(self)):
            if ends == (None,) and starts[0] < 0:
                return [self._end(-starts[0])[0]]
            if None in ends or not ends:
                return super().read_ranges(ranges)
            parts = self._store.get_ranges(
                self.key, starts=starts, ends=ends, coalesce=_BETWEEN_BYTES
            )
            return [bytes(part) for part in parts]

    def _end(self, nbytes: int) -> tuple[bytes, int]:
        """Read the last bytes of a file; return them and the file's size."""
        response = self._store.get(self.key, options={"range": {"suffix": nbytes}})
        return bytes(response.bytes()), int(response.meta["size"])

    def open(self) -> IO[bytes]:
        """Open a file for ranged reads; its end, with a zip's directory, is read at once."""
        with _errors(str(self)):
            tail, size = self._end(_AHEAD_BYTES)
        return cast(IO[bytes], io.BufferedReader(_Ranged(self, tail, size), _AHEAD_BYTES))

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
        """Sizes in bytes of all objects in a bucket's folder, by name."""
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
    """A writable folder in a bucket, ``s3://bucket/folder``.

    Credentials, region and endpoint come from the environment: ``AWS_ACCESS_KEY_ID``,
    ``AWS_SECRET_ACCESS_KEY``, ``AWS_SESSION_TOKEN``, ``AWS_REGION``, ``AWS_ENDPOINT_URL``.
    """

    def __init__(self, address: str) -> None:
        if not address.startswith("s3:"):
            raise InputError(f"{address}: expected a bucket, such as s3://lab/desk")
        super().__init__(*_connect(address, _WRITING))

    def put(self, name: str, content: Path | bytes) -> None:
        """Write an object; it replaces an existing one when it is complete.

        Raises
        ------
        StoreError
            When the bucket is missing or read-only, or its server doesn't answer.
        """
        place = self / name
        kind = mimetypes.guess_type(name)[0] or "application/octet-stream"
        with _errors(str(place), "written"):
            self._store.put(
                place.key,
                content,
                attributes={"Content-Type": kind},
                chunk_size=_PART_BYTES,
                max_concurrency=_PARTS_AT_ONCE,
            )


class _Ranged(io.RawIOBase):
    """A remote file whose last bytes are in memory."""

    def __init__(self, place: ObjectPlace, tail: bytes, size: int) -> None:
        self._place, self._tail, self._size = place, tail, size
        self._position = 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        base = {io.SEEK_SET: 0, io.SEEK_CUR: self._position, io.SEEK_END: self._size}[whence]
        self._position = max(0, base + offset)
        return self._position

    def readinto(self, buffer: Any) -> int:
        start, stop = self._position, min(self._position + len(buffer), self._size)
        tail = self._size - len(self._tail)
        if start < min(stop, tail):
            (content,) = self._place.read_ranges([(start, min(stop, tail))])
        else:
            content = self._tail[start - tail : max(0, stop - tail)]
        buffer[: len(content)] = content
        self._position += len(content)
        return len(content)


def _connect(address: str, client: dict[str, Any]) -> tuple[Any, str, str]:
    """Return the obstore store of a server or bucket, the key in it, and its root address."""
    with needing("publish", f"access to {address}", StoreError):
        from obstore.exceptions import BaseError
        from obstore.store import HTTPStore, S3Store
    settings: dict[str, Any] = {
        "client_options": {"allow_http": True, **client},
        "retry_config": _RETRIES,
    }
    try:
        if address.startswith("s3:"):
            parts = _bucket_of(address)
            if not any(map(_CREDENTIALS.fullmatch, os.environ)):
                settings["skip_signature"] = True
            root = f"s3://{parts.netloc}"
            return S3Store(parts.netloc, **settings), parts.path.strip("/"), root
        parts = _split(address)
        if parts.username is not None:  # obstore ignores it
            user = f"{unquote(parts.username)}:{unquote(parts.password or '')}"
            encoded = base64.b64encode(user.encode()).decode()
            settings["client_options"]["default_headers"] = {"Authorization": f"Basic {encoded}"}
        root = f"{parts.scheme}://{parts.netloc.rpartition('@')[2]}"
        return HTTPStore.from_url(f"{root}/", **settings), unquote(parts.path).strip("/"), root
    except (ValueError, BaseError) as error:
        raise InputError(
            f"{address}: {_reason(error)}; check the address and, for s3://, the AWS_... variables"
        ) from None


def _bucket_of(address: str) -> SplitResult:
    """Split a bucket's address; ValueError if it or the environment is invalid."""
    parts = urlsplit(address)
    if not _BUCKET.fullmatch(parts.netloc) or parts.query or parts.fragment:
        raise ValueError(
            "expected a bucket, or a folder or object in one, such as s3://lab/desk; credentials "
            "belong in the environment: AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY"
        )
    for name in filter(os.environ.__contains__, _ENDPOINTS):
        try:  # obstore aborts on an invalid one
            _split(os.environ[name])
        except ValueError:
            raise ValueError(
                f"the environment's {name} is {os.environ[name]!r}; expected the server's "
                "address, such as https://objects.example.org; remove it for Amazon's"
            ) from None
    return parts


def _split(address: str) -> SplitResult:
    parts = urlsplit(address)
    wrong = parts.scheme not in ("http", "https") or not parts.hostname or parts.port == 0
    if wrong or parts.query or parts.fragment:
        raise ValueError(
            "expected http://, https:// or s3:// with a host or bucket and a path, and without '?' "
            "or '#'"
        )
    return parts


@contextmanager
def _errors(place: str, action: str = "read") -> Iterator[None]:
    """Convert obstore's errors to a StoreError of one line, except FileNotFoundError."""
    from obstore.exceptions import BaseError

    # without a cause: obstore's message contains the address with user name and password
    try:
        yield
    except (BaseError, FileNotFoundError) as error:
        name = "NoSuchBucket" if "NoSuchBucket" in str(error) else type(error).__name__
        if name == "FileNotFoundError":
            raise FileNotFoundError(place) from None
        kind = StoreError if name in _ADVICE else UnreachableError
        advice = _ADVICE.get(name, _WITHOUT_NETWORK)
        raise kind(f"{place}: can't be {action}: {_reason(error)}; {advice}") from None


def _reason(error: Exception) -> str:
    """Extract the message of obstore or the server as one line."""
    text = " ".join(str(error).partition("\n\nDebug source")[0].split())
    message = _MESSAGE.search(text)
    return f"{message[1]}: {message[2]}" if message else text
