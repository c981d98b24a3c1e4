"""Transports as pages that any browser opens: light them, and see what comes back."""

from rfpipe.viewer.build import Compared, View, Written, write_view
from rfpipe.viewer.lowering import lower
from rfpipe.viewer.stored import write_acquisition

__all__ = ["Compared", "View", "Written", "lower", "write_acquisition", "write_view"]
