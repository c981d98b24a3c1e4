"""The acquisition server: runs next to the devices, owns them, and serves one client at a time.

``rfpipe serve RIG.yaml`` runs it; `rfpipe.rigs.RemoteRig` is its client. FastAPI and uvicorn are
loaded when a server is made.
"""

from rfpipe.server.settings import ServerSettings

__all__ = ["ServerSettings"]
