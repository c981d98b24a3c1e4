"""Reading behind an address, by ranges: http(s) servers and S3, through obstore."""

from __future__ import annotations

import io
import os
import re
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from datetime import timedelta
from typing import IO, Any, cast
from urllib.parse import urlsplit

from rfpipe.errors import InputError, StoreError, without_password
from rfpipe.store.places import Place

__all__ = ["CREDENTIALS", "ObjectPlace", "connect", "open_ranged", "reason_of"]

_SCHEMES = ("http", "https", "s3")
_AT_ONCE = 16  # requests: each waits for the way there and back, and carries little
_RETRIES: Any = {"max_retries": 3, "retry_timeout": timedelta(seconds=30)}

# Of a zip file's end: the directory of some thousand files, and the metadata written before it.
_TAIL_BYTES = 256 * 2**10
# A request takes as long as half a MB on a usual line, so that reading on costs little; whoever
# goes on reading gets twice as much each time.
_FIRST_BYTES, _MOST_BYTES = 256 * 2**10, 8 * 2**20
# of the answer of S3's servers
_MESSAGE = re.compile(r"(\d{3} [A-Za-z ]+): .*<Message>(.*?)</Message>")
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
        return f"{self._root}/{self.key}"

    def _at(self, key: str) -> ObjectPlace:
        return ObjectPlace(self._store, key, self._root)

    def read_bytes(self) -> bytes:
        """Read a file."""
        with remote_errors(str(self)):
            return bytes(self._store.get(self.key).bytes())

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
            try:
                found = store.get(key, options={"range": {"suffix": _TAIL_BYTES}})
            except FileNotFoundError:
                raise StoreError(f"{address}: no such file; check the address") from None
            self._size = int(found.meta["size"])
            self._tail = bytes(found.bytes())
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


def open_ranged(store: Any, key: str, address: str) -> IO[bytes]:
    """Open a file behind an address, to be read by ranges.

    Raises
    ------
    StoreError
        When there is none, or the server doesn't answer, or not by ranges.
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
    parts = urlsplit(address)
    scheme = parts.scheme.lower()
    if scheme not in _SCHEMES or not parts.netloc or parts.query or parts.fragment:
        raise InputError(
            f"{address}: expected http://, https:// or s3:// with a host or bucket and a path, "
            "and without '?' or '#'"
        )
    try:
        from obstore.store import HTTPStore, S3Store
    except ImportError as error:
        raise StoreError(
            f"{address}: to read behind an address needs the extra publish; run "
            "'pip install rfpipe[publish]', or download it"
        ) from error
    root = f"{scheme}://{parts.netloc}"  # with a password, if the address has one
    options: Any = {"allow_http": True, **(client or {})}
    retries = retries or _RETRIES
    store: Any
    if scheme == "s3":
        signed = any(os.environ.get(name) for name in CREDENTIALS)
        unsigned: Any = {} if signed else {"skip_signature": True}
        store = S3Store(
            parts.netloc,
            client_options=options,
            retry_config=retries,
            **unsigned,
        )
    else:
        store = HTTPStore.from_url(f"{root}/", client_options=options, retry_config=retries)
    return store, parts.path.strip("/"), without_password(root)


@contextmanager
def remote_errors(address: str) -> Iterator[None]:
    """Turn what obstore raises into a StoreError of one line; FileNotFoundError passes."""
    from obstore.exceptions import BaseError

    try:
        yield
    except BaseError as error:
        raise StoreError(
            f"{address}: can't be read: {reason_of(error)}; check the address, the rights to read "
            "it and that its server answers range requests, or download it and open the file"
        ) from None  # obstore's own message shows the address as it was given


def reason_of(error: Exception) -> str:
    """Return what obstore or the server says is wrong, in one line."""
    said = " ".join(str(error).partition("\n\nDebug source")[0].split())
    message = _MESSAGE.search(said)
    return f"{message[1]}: {message[2]}" if message else said
