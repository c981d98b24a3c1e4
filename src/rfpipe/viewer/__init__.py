"""Interactive pages that relight a transport in any browser."""

from rfpipe.viewer.build import Comparison, PageContent, WrittenPage, write_view
from rfpipe.viewer.lowering import lower
from rfpipe.viewer.stored import write_acquisition

__all__ = ["Comparison", "PageContent", "WrittenPage", "lower", "write_acquisition", "write_view"]
