"""Picture files that other programs wrote, or are to show: pixels, exposure times, and order."""

from rfpipe.pictures.exposures import encoding_note, relative_exposures
from rfpipe.pictures.files import picture_files, read_header, read_parts, read_picture
from rfpipe.pictures.images import write_code_picture
from rfpipe.pictures.raw import check_raw_mosaic, developed
from rfpipe.pictures.records import Header, Part, Picture
from rfpipe.pictures.sequence import check_sequence, pixel_fingerprint

__all__ = [
    "Header",
    "Part",
    "Picture",
    "check_raw_mosaic",
    "check_sequence",
    "developed",
    "encoding_note",
    "picture_files",
    "pixel_fingerprint",
    "read_header",
    "read_parts",
    "read_picture",
    "relative_exposures",
    "write_code_picture",
]
