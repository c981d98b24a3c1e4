"""The catalogue: every acquisition of a run on one page, with what became of it."""

from rfpipe.report.catalogue.page import CATALOGUE, left_over, write_catalogue

__all__ = ["CATALOGUE", "left_over", "write_catalogue"]
