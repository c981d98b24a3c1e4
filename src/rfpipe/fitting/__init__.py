"""Light transport from pictures of patterns that somebody else chose."""

from rfpipe.fitting.folder import Series, read_series
from rfpipe.fitting.linear import Fit, fit_transport

__all__ = ["Fit", "Series", "fit_transport", "read_series"]
