"""Picture files that other programs wrote, or are to show: pixels, exposure times, and order."""

from rfpipe.pictures.files import Header, Picture, picture_files, read_header, read_picture
from rfpipe.pictures.images import write_code_picture

__all__ = [
    "Header",
    "Picture",
    "picture_files",
    "read_header",
    "read_picture",
    "write_code_picture",
]
