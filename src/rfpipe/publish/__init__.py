"""Publishing a run: a crate that can be cited, checked, and read without the rest of the run."""

from rfpipe.publish.citation import (
    CITATION_FILE,
    Citation,
    Creator,
    citation_values,
    parse_citation,
    write_citation,
)
from rfpipe.publish.contents import Run, find_run
from rfpipe.publish.job import Published, publish
from rfpipe.publish.keep import Kept, keep

__all__ = [
    "CITATION_FILE",
    "Citation",
    "Creator",
    "Kept",
    "Published",
    "Run",
    "citation_values",
    "find_run",
    "keep",
    "parse_citation",
    "publish",
    "write_citation",
]
