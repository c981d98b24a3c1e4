"""The report of a run: the thesis' figures and tables for the acquired scenes."""

from rfpipe.report.check import check_page
from rfpipe.report.page import build_report

__all__ = ["build_report", "check_page"]
