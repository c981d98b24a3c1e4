"""HTTP to an acquisition server that may be away for a while."""

from __future__ import annotations

import logging
import threading
from typing import TYPE_CHECKING, Any

from rfpipe.config.addresses import check_server
from rfpipe.errors import CaptureError, InputError
from rfpipe.rigs.patience import Patience

if TYPE_CHECKING:
    import httpx

__all__ = ["Connection", "RefusedError"]

_CONNECT_SECONDS = 5.0
_ANSWER_SECONDS = 30.0
# a bracket may take some times what the rig says: retries of the camera, a device that reconnects
_SLACK = 4.0
_KEEP_ALIVE_SECONDS = 60.0
_COME_AGAIN = (408, 409, 429, 503)

_log = logging.getLogger(__name__)


class RefusedError(CaptureError):
    """The server's answer is an error that waiting doesn't mend.

    Attributes
    ----------
    status : int
    detail : str
    """

    def __init__(self, url: str, status: int, detail: str) -> None:
        super().__init__(f"{url}: the server refused with status {status}: {detail}")
        self.status = status
        self.detail = detail


class Connection:
    """Sends requests until they are answered.

    Parameters
    ----------
    url : str
        Of the server, without a path.
    token : str
    patience_seconds : float
        How long to wait since the server last answered, at least 0.

    Raises
    ------
    InputError
        When a parameter is wrong.
    """

    def __init__(self, url: str, token: str, patience_seconds: float) -> None:
        import httpx

        try:
            check_server(url)
        except ValueError as error:
            raise InputError(f"url is {url!r}; it {error}") from None
        if not 0 <= patience_seconds < float("inf"):
            raise InputError(f"patience_seconds is {patience_seconds}; expected at least 0")
        self._settings = (url, token, patience_seconds)
        self._url = url.rstrip("/")
        self._patience = patience_seconds
        self._http = httpx.Client(
            base_url=self._url,
            headers={"Authorization": f"Bearer {token}"},
            limits=httpx.Limits(max_connections=1, keepalive_expiry=_KEEP_ALIVE_SECONDS),
            verify=url.startswith("https"),  # without it, certificates needn't be loaded
            trust_env=False,  # a proxy for the web doesn't lead to a rig
        )
        self.closing = threading.Event()
        self._waiting = self.patience()

    def another(self) -> Connection:
        """Return a second connection to the same server, for another thread."""
        return Connection(*self._settings)

    def patience(self) -> Patience:
        """Return as much patience as this connection has, for something behind the server."""
        return Patience(self._url, self._patience, self.closing)

    def send(self, method: str, path: str, seconds: float = 0.0, **request: Any) -> httpx.Response:
        """Send a request until the server answers it; `seconds` is the rig's part of the time.

        Raises
        ------
        RefusedError
            When the answer is an error.
        CaptureError
            When there is no answer, or others hold the rig, for longer than the patience.
        """
        import httpx

        while True:
            try:
                response = self.try_once(method, path, seconds, **request)
            except httpx.TransportError as error:
                self.pause(
                    f"no answer ({type(error).__name__}: {error}); check that 'rfpipe serve' runs "
                    "there, and the network"
                )
                continue
            if response.status_code not in _COME_AGAIN:
                break
            self.pause(_detail(response))
        if self._waiting.is_tried:
            _log.warning("%s: answers again; going on", self._url)
            self._waiting.end()
        if response.is_success:
            return response
        detail = _detail(response)
        if response.status_code == 401:
            detail += "; see capture.token_file, or the environment variable with the token"
        raise RefusedError(self._url, response.status_code, detail)

    def try_once(
        self, method: str, path: str, seconds: float = 0.0, **request: Any
    ) -> httpx.Response:
        """Send a request and return whatever answer; raises httpx.TransportError without one."""
        import httpx

        timeout = httpx.Timeout(_ANSWER_SECONDS + _SLACK * seconds, connect=_CONNECT_SECONDS)
        return self._http.request(method, path, timeout=timeout, **request)

    def pause(self, reason: str) -> None:
        """Wait a little before the next attempt, longer each time; tell why from time to time.

        Raises
        ------
        CaptureError
            When the patience is at its end.
        """
        self._waiting.pause(reason)

    def close(self) -> None:
        """Close the connection; closing twice is no error."""
        self.closing.set()
        self._http.close()


def _detail(response: httpx.Response) -> str:
    """Return what an error says of itself."""
    try:
        detail = response.json()["detail"]
    except (ValueError, KeyError, TypeError):
        detail = response.text[:200]
    return f"{detail} (status {response.status_code})"
