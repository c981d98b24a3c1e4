"""What the camera sees, live, for who sets a rig up: framing, focus and exposure."""

from rfpipe.server.aim.app import create_app
from rfpipe.server.aim.run import aim
from rfpipe.server.aim.watch import Watch

__all__ = ["Watch", "aim", "create_app"]
