"""Reading behind an address, by ranges: http(s) servers and S3, through obstore."""

from __future__ import annotations

import base64
import io
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from datetime import timedelta
from typing import IO, Any, cast
from urllib.parse import SplitResult, unquote, urlsplit

from rfpipe.errors import InputError, StoreError, UnreachableError, installing
from rfpipe.store.places import Place, Range

__all__ = ["CREDENTIALS", "ObjectPlace", "connect", "open_ranged", "reason_of"]

_SCHEMES = ("http", "https", "s3")
_AT_ONCE = 16  # requests: each waits for the way there and back, and carries little
# However slow a line is, it is waited for while bytes come, at most a day; one that stalls is
# asked once more.
_RETRIES: Any = {"max_retries": 3, "retry_timeout": timedelta(seconds=60)}
_CLIENT: dict[str, Any] = {"timeout": timedelta(days=1), "read_timeout": timedelta(seconds=30)}

# Of a zip file's end: the directory of some thousand files, and the metadata written before it.
_TAIL_BYTES = 256 * 2**10
# A request takes as long as half a MB on a usual line, so that reading on costs little; whoever
# goes on reading gets twice as much each time.
_FIRST_BYTES, _MOST_BYTES = 256 * 2**10, 8 * 2**20
# What lies between two parts that are wanted and is fetched with them rather than asked twice.
_BETWEEN_BYTES = 32 * 2**10
# of the answer of S3's servers
_MESSAGE = re.compile(r"(\d{3} [A-Za-z ]+): .*<Message>(.*?)</Message>")
_ENDPOINTS = ("AWS_ENDPOINT_URL", "AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT")
_BUCKET = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")
CREDENTIALS = (
    "AWS_ACCESS_KEY_ID",
    "AWS_WEB_IDENTITY_TOKEN_FILE",
    "AWS_CONTAINER_CREDENTIALS_RELATIVE_URI",
    "AWS_CONTAINER_CREDENTIALS_FULL_URI",
)
"""What signs requests to S3; without, they go unsigned, as public buckets take them."""


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

    def __str__(self) -> str:
        return f"{self._root}/{_written(self._root, self.key)}".rstrip("/")

    def at(self, key: str) -> ObjectPlace:
        """Return another place in the same whole."""
        return ObjectPlace(self._store, key, self._root)

    def read_bytes(self) -> bytes:
        """Read a file."""
        with remote_errors(str(self)):
            return bytes(self._store.get(self.key).bytes())

    def read_ranges(self, ranges: Sequence[Range]) -> list[bytes]:
        """Read parts of a file; those that lie close together with what is between them."""
        if any(stop is None for _, stop in ranges):
            return super().read_ranges(ranges)
        with remote_errors(str(self)):
            return _ranges(self._store, self.key, ranges)

    def read_end(self, nbytes: int) -> tuple[bytes, int]:
        """Read the last bytes of a file; these and the file's size."""
        with remote_errors(str(self)):
            found = self._store.get(self.key, options={"range": {"suffix": nbytes}})
            return bytes(found.bytes()), int(found.meta["size"])

    def open(self) -> IO[bytes]:
        """Open a file, to be read by ranges."""
        return open_ranged(self._store, self.key, str(self))

    def files(self) -> list[str]:
        """Keys of all files in this folder; a web server doesn't tell."""
        if not self._root.startswith("s3:"):
            raise StoreError(
                f"{self}: a web server doesn't list its files; give the address of a "
                "transport.zarr, of a .zip, or of a folder that 'rfpipe publish' made"
            )
        return sorted(key.removeprefix(f"{self.key}/") for key, _ in self._listed())

    def nbytes(self) -> int | None:
        """Bytes of all files in this folder; a web server doesn't tell."""
        if not self._root.startswith("s3:"):
            return None
        return sum(size for _, size in self._listed())

    def read_many(self, names: Iterable[str]) -> dict[str, bytes]:
        """Read those of the files of these names that there are, several at once."""

        def read(name: str) -> bytes | None:
            try:
                return (self / name).read_bytes()
            except FileNotFoundError:
                return None

        names = list(names)
        with ThreadPoolExecutor(_AT_ONCE) as pool:
            found = zip(names, pool.map(read, names), strict=True)
            return {name: content for name, content in found if content is not None}

    def _listed(self) -> list[tuple[str, int]]:
        with remote_errors(str(self)):
            pages = self._store.list(prefix=self.key or None)
            return [(entry["path"], entry["size"]) for page in pages for entry in page]


class _Ranged(io.RawIOBase):
    """A file behind an address that is read by ranges, and a little ahead.

    Its end comes with the first request: that is where zip files keep their directory.

    Attributes
    ----------
    until : int
        Up to where to read ahead; the file's end, unless somebody knows better.
    """

    def __init__(self, store: Any, key: str, address: str) -> None:
        self._store, self._key, self._address = store, key, address
        with remote_errors(address):
            self._tail, self._size = _end(store, key)
        self.until = self._size
        self._position = 0
        self._ahead = _FIRST_BYTES
        self._start, self._block = 0, b""

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def tell(self) -> int:
        return self._position

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        base = {io.SEEK_SET: 0, io.SEEK_CUR: self._position, io.SEEK_END: self._size}[whence]
        if base + offset < 0:
            raise OSError(f"{self._address}: no place {base + offset} in a file")
        self._position = base + offset
        return self._position

    def read(self, size: int | None = -1) -> bytes:
        stop = self._size if size is None or size < 0 else min(self._position + size, self._size)
        if stop <= self._position:
            return b""
        content = self._range(self._position, stop)
        self._position = stop
        return content

    def readinto(self, buffer: Any) -> int:
        content = self.read(len(buffer))
        buffer[: len(content)] = content
        return len(content)

    def ranges(self, ranges: Sequence[tuple[int, int]]) -> list[bytes]:
        """Read parts of the file without reading ahead; threads may do so at once."""
        tail = self._size - len(self._tail)
        apart = [(start, stop) for start, stop in ranges if start < tail]
        with remote_errors(self._address):
            fetched = iter(_ranges(self._store, self._key, apart))
        return [
            next(fetched) if start < tail else self._tail[start - tail : stop - tail]
            for start, stop in ranges
        ]

    def _range(self, start: int, stop: int) -> bytes:
        """Bytes [start, stop) of the file: of its end, of what was read last, or fetched."""
        tail = self._size - len(self._tail)
        if start >= tail:
            return self._tail[start - tail : stop - tail]
        end = self._start + len(self._block)
        if not self._start <= start <= end:
            self._block, self._ahead = b"", _FIRST_BYTES
        elif stop <= end:
            return self._block[start - self._start : stop - self._start]
        held = self._block[start - self._start :] if self._block else b""
        first = start + len(held)
        with remote_errors(self._address):
            last = max(stop, min(first + self._ahead, self.until))
            fetched = bytes(self._store.get_range(self._key, start=first, end=last))
        self._start, self._block = start, held + fetched
        self._ahead = min(2 * self._ahead, _MOST_BYTES)
        return self._block[: stop - start]


def _end(store: Any, key: str) -> tuple[bytes, int]:
    """Read the last bytes of a file behind an address, and its size."""
    from obstore.exceptions import BaseError

    try:
        found = store.get(key, options={"range": {"suffix": _TAIL_BYTES}})
        return bytes(found.bytes()), int(found.meta["size"])
    except BaseError:
        try:
            if store.head(key)["size"] == 0:  # an empty file has no range that could be asked for
                return b"", 0
        except (BaseError, OSError):
            pass  # the first error tells more
        raise


def _ranges(store: Any, key: str, ranges: Sequence[Range]) -> list[bytes]:
    """Read parts of a file behind an address."""
    if not ranges:
        return []
    starts, ends = zip(*ranges, strict=True)
    return [bytes(part) for part in store.get_ranges(
        key, starts=starts, ends=ends, coalesce=_BETWEEN_BYTES)]  # fmt: skip


def open_ranged(store: Any, key: str, address: str) -> IO[bytes]:
    """Open a file behind an address, to be read by ranges.

    Raises
    ------
    FileNotFoundError
        When there is none.
    StoreError
        When the server doesn't answer, or not by ranges.
    """
    return cast(IO[bytes], _Ranged(store, key, address))


def connect(
    address: str, *, retries: Any = None, client: dict[str, Any] | None = None
) -> tuple[Any, str, str]:
    """Return the obstore store of an address's server or bucket, the key in it, and its root.

    Parameters
    ----------
    address : str
    retries, client
        Options of obstore: when a request is repeated, and how long it may take.

    Raises
    ------
    InputError
        When the address is of another kind.
    StoreError
        When obstore isn't installed.
    """
    parts = _parts(address)
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
    options: Any = {"allow_http": True, **(_CLIENT if client is None else client)}
    retries = retries or _RETRIES
    try:
        if parts.scheme == "s3":
            signed = any(os.environ.get(name) for name in CREDENTIALS)
            unsigned: Any = {} if signed else {"skip_signature": True}
            bucket = S3Store(host, client_options=options, retry_config=retries, **unsigned)
            return bucket, parts.path.strip("/"), root
        if parts.username is not None:  # which obstore leaves out
            options["default_headers"] = {"Authorization": _basic(parts)}
        server = HTTPStore.from_url(f"{root}/", client_options=options, retry_config=retries)
    except (ValueError, BaseError) as error:
        raise InputError(
            f"{address}: can't be opened: {reason_of(error)}; check the address"
            + (" and the environment's AWS_..." if parts.scheme == "s3" else "")
        ) from None
    return server, unquote(parts.path).strip("/"), root


def _parts(address: str) -> SplitResult:
    """Return the parts of an address, its scheme in lower case.

    Raises
    ------
    InputError
        When it is of another kind.
    """
    try:
        parts = urlsplit(address)
        scheme, _ = parts.scheme.lower(), parts.port  # which is a number, or raises
    except ValueError as error:
        raise InputError(f"{address}: can't be an address: {error}") from None
    if scheme not in _SCHEMES or not parts.hostname or parts.query or parts.fragment:
        raise InputError(
            f"{address}: expected http://, https:// or s3:// with a host or bucket and a path, "
            "and without '?' or '#'"
        )
    if scheme == "s3" and parts.username is not None:
        raise InputError(
            f"{address}: names a user; give credentials as AWS_ACCESS_KEY_ID and "
            "AWS_SECRET_ACCESS_KEY in the environment"
        )
    if scheme == "s3":
        _check_bucket(parts.netloc, address)
    return parts._replace(scheme=scheme)


def _check_bucket(bucket: str, address: str) -> None:
    """Refuse a bucket's name, or a server's address in the environment, that obstore dies of."""
    if not _BUCKET.fullmatch(bucket):
        raise InputError(
            f"{address}: {bucket!r} can't be a bucket; expected letters, digits, '.', '_' and '-'"
        )
    for name in _ENDPOINTS:
        if name in os.environ and not _is_server(os.environ[name]):
            raise InputError(
                f"{address}: the environment's {name} is {os.environ[name]!r}; expected the "
                "server's address, such as https://objects.example.org, or none for Amazon's"
            )


def _is_server(address: str) -> bool:
    try:
        parts = urlsplit(address)
        port = parts.port
    except ValueError:
        return False
    return parts.scheme in ("http", "https") and bool(parts.hostname) and port != 0


def _basic(parts: SplitResult) -> str:
    """Return what tells a web server the user and the password of an address."""
    user = f"{unquote(parts.username or '')}:{unquote(parts.password or '')}"
    return f"Basic {base64.b64encode(user.encode()).decode()}"


def _written(root: str, key: str) -> str:
    """Return a key as an address has it: a web server's can be copied into another program."""
    if root.startswith("s3:"):
        return key
    return key.replace("%", "%25").replace("?", "%3F").replace("#", "%23")


@contextmanager
def remote_errors(address: str) -> Iterator[None]:
    """Turn what obstore raises into a StoreError of one line; FileNotFoundError passes."""
    from obstore.exceptions import (
        BaseError,
        NotSupportedError,
        PermissionDeniedError,
        UnauthenticatedError,
    )

    is_s3 = address.startswith("s3:")
    # none of them chained: obstore's own message shows the address as it was given
    try:
        yield
    except NotSupportedError as error:
        raise StoreError(
            f"{address}: can't be read: {reason_of(error)}; its server doesn't answer range "
            "requests, or answers a page of its own, such as one to log in: check the address, or "
            "download it and open the file"
        ) from None
    except (PermissionDeniedError, UnauthenticatedError) as error:
        what = "the credentials of the environment and their rights" if is_s3 else "who may read it"
        raise StoreError(
            f"{address}: can't be read: {reason_of(error)}; check the address and {what}"
        ) from None
    except BaseError as error:
        reason = reason_of(error)
        what = "AWS_ENDPOINT_URL, AWS_REGION and the credentials" if is_s3 else "the address"
        advice = f"check the network and {what}"
        if reason.startswith("416"):
            advice = "it was replaced by a shorter file after it was opened: open it again"
        raise UnreachableError(f"{address}: can't be read: {reason}; {advice}") from None


def reason_of(error: Exception) -> str:
    """Return what obstore or the server says is wrong, in one line."""
    said = " ".join(str(error).partition("\n\nDebug source")[0].split())
    message = _MESSAGE.search(said)
    return f"{message[1]}: {message[2]}" if message else said
