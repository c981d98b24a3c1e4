"""Light transport from pictures of patterns that somebody else chose."""

from rfpipe.fitting.choose import Fit, fit_transport
from rfpipe.fitting.folder import Series, read_series

__all__ = ["Fit", "Series", "fit_transport", "read_series"]
