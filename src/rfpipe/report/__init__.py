"""The report of a run: the thesis' figures and tables for the acquired scenes."""

from rfpipe.report.build import build_report
from rfpipe.report.page import check_page

__all__ = ["build_report", "check_page"]
