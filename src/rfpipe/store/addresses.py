"""Objects behind an address, http(s) or S3, through obstore: read by ranges, written whole."""

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
# Of a zip file's end, the directory of some thousand files, and the metadata written before it;
# and what is read ahead: a request takes as long as half a MB on a usual line.
_AHEAD_BYTES = 256 * 2**10
# What lies between two parts that are wanted and is fetched with them rather than asked twice.
_BETWEEN_BYTES = 32 * 2**10
_MESSAGE = re.compile(r"(\d{3} [A-Za-z ]+): .*<Message>(.*?)</Message>")  # of S3's servers
_ENDPOINTS = ("AWS_ENDPOINT_URL", "AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT")
_BUCKET = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")
# Without these, requests to S3 go unsigned, as public buckets take them.
_CREDENTIALS = re.compile(
    "AWS_(ACCESS_KEY_ID|WEB_IDENTITY_TOKEN_FILE|CONTAINER_CREDENTIALS_(RELATIVE|FULL)_URI)"
)
_DENIED = (
    "check who may do it, and of s3:// the credentials of the environment (AWS_ACCESS_KEY_ID, "
    "AWS_SECRET_ACCESS_KEY) and AWS_ENDPOINT_URL"
)
_ADVICE = {
    "NoSuchBucket": "there is no such bucket; make it, or check the address and AWS_ENDPOINT_URL",
    "NotSupportedError": "its server doesn't answer range requests, or answers a page of its own, "
    "such as one to log in: check the address, or download it and open the file",
    "PermissionDeniedError": _DENIED,
    "UnauthenticatedError": _DENIED,
}
_WITHOUT_NETWORK = (
    "check the network, the address and, of s3://, AWS_ENDPOINT_URL, then run again: an upload "
    "goes on where it stopped"
)


class ObjectPlace(Place):
    """A folder or file behind an address, in a store of obstore, whose own address is `root`."""

    def __init__(self, store: Any, key: str, root: str) -> None:
        super().__init__(key)
        self._store, self._root = store, root

    @classmethod
    def of(cls, address: str) -> ObjectPlace:
        """Return the place of an address; InputError where it is of another kind."""
        return cls(*_connect(address, _READING))

    def __str__(self) -> str:
        # can be copied into another program
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
        """Return the last bytes of a file, and its size."""
        response = self._store.get(self.key, options={"range": {"suffix": nbytes}})
        return bytes(response.bytes()), int(response.meta["size"])

    def open(self) -> IO[bytes]:
        """Open a file, to be read by ranges; its end, a zip's directory, comes with the first."""
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
    """

    def __init__(self, address: str) -> None:
        if not address.startswith("s3:"):
            raise InputError(f"{address}: should be a bucket, such as s3://lab/desk")
        super().__init__(*_connect(address, _WRITING))

    def put(self, name: str, content: Path | bytes) -> None:
        """Write an object, which replaces an older one once it is whole.

        Raises
        ------
        StoreError
            When the bucket is missing or may not be written, or its server doesn't answer.
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
    """A file behind an address, of which the last bytes are known."""

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
    """Return the obstore store of an address's server or bucket, the key in it, and its root."""
    try:
        from obstore.exceptions import BaseError
        from obstore.store import HTTPStore, S3Store
    except ImportError as error:
        raise StoreError(
            f"{address}: to read behind an address needs the extra publish; download it, or "
            f"{installing('publish')}"
        ) from error
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
        if parts.username is not None:  # which obstore leaves out
            user = f"{unquote(parts.username)}:{unquote(parts.password or '')}"
            encoded = base64.b64encode(user.encode()).decode()
            settings["client_options"]["default_headers"] = {"Authorization": f"Basic {encoded}"}
        root = f"{parts.scheme}://{parts.netloc.rpartition('@')[2]}"
        return HTTPStore.from_url(f"{root}/", **settings), unquote(parts.path).strip("/"), root
    except (ValueError, BaseError) as error:
        raise InputError(
            f"{address}: {_reason(error)}; check the address, of s3:// the environment's AWS_..."
        ) from None


def _bucket_of(address: str) -> SplitResult:
    """Return the parts of a bucket's address; ValueError where it or the environment is wrong."""
    parts = urlsplit(address)
    if not _BUCKET.fullmatch(parts.netloc) or parts.query or parts.fragment:
        raise ValueError(
            "should be a bucket, or a folder or object in one, such as s3://lab/desk; credentials "
            "stand in the environment, as AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY"
        )
    for name in filter(os.environ.__contains__, _ENDPOINTS):
        try:  # obstore dies of a wrong one
            _split(os.environ[name])
        except ValueError:
            raise ValueError(
                f"the environment's {name} is {os.environ[name]!r}; expected the server's "
                "address, such as https://objects.example.org, or none for Amazon's"
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
    """Turn what obstore raises into a StoreError of one line; FileNotFoundError passes."""
    from obstore.exceptions import BaseError

    # none of them chained: obstore's own message shows the address as it was given
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
    """Return what obstore or the server says is wrong, in one line."""
    text = " ".join(str(error).partition("\n\nDebug source")[0].split())
    message = _MESSAGE.search(text)
    return f"{message[1]}: {message[2]}" if message else text
