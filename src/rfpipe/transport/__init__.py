"""Transport operators: dense, multilevel sparse (dual) and the hierarchical tensor."""

from rfpipe.transport.base import Transport, save_transport
from rfpipe.transport.regrouping import coarser
from rfpipe.transport.relightable import TransposedTransport
from rfpipe.transport.storage import open_transport

__all__ = ["Transport", "TransposedTransport", "coarser", "open_transport", "save_transport"]
