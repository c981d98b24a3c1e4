"""Data on disk: frame stores with journals, bundles and temporary arrays, manifests and locks.

Only this package imports zarr, and only to create a store; manifests, journals and locks don't
need it.
"""

from rfpipe.store.arrays import ArrayBundle, open_arrays, write_arrays
from rfpipe.store.files import bytes_on_disk, to_disk
from rfpipe.store.headers import header_is_whole, keep_header, restore_header
from rfpipe.store.items import ItemWriter
from rfpipe.store.lock import StoreLock
from rfpipe.store.manifest import manifest_or_empty, read_manifest, write_manifest
from rfpipe.store.pictures import PictureStore, drop, is_dropped

__all__ = [
    "ArrayBundle",
    "ItemWriter",
    "PictureStore",
    "StoreLock",
    "bytes_on_disk",
    "drop",
    "header_is_whole",
    "is_dropped",
    "keep_header",
    "manifest_or_empty",
    "open_arrays",
    "read_manifest",
    "restore_header",
    "to_disk",
    "write_arrays",
    "write_manifest",
]
