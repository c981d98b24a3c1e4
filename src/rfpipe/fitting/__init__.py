"""Light transport from pictures of patterns that somebody else chose."""

from rfpipe.fitting.choose import FittedTransport, fit_transport
from rfpipe.fitting.flat_field import flat_fielded
from rfpipe.fitting.reading import read_series
from rfpipe.fitting.series import Series

__all__ = ["FittedTransport", "Series", "fit_transport", "flat_fielded", "read_series"]
