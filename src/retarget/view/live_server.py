"""The server of the live viewer: viser's, on the loopback address only, closed to web pages of other places.

Any page that a browser has open can send requests to servers on the same machine. Browsers say with every request which
host they think they speak to (`Host`), and with every websocket which page asks for it (`Origin`); both must name this
machine, and the same host and port. So neither a page from elsewhere nor a name that was made to lead here gets in.
"""

from __future__ import annotations

import contextlib
import io
import threading
from collections.abc import Iterator
from typing import Any
from urllib.parse import urlsplit

from retarget.errors import RetargetError

HOST = "127.0.0.1"
"""The only address that is listened on."""
NAMES = (HOST, "localhost")
"""What this machine may be called by a browser."""
_STARTING = threading.Lock()


def require_viser() -> Any:
    """The package viser. Raises `RetargetError` naming what to install where it is absent."""
    try:
        import viser
    except ImportError:
        raise RetargetError("the viewer needs viser, which is not installed: pip install retarget[view]") from None
    return viser


def quiet() -> contextlib.AbstractContextManager:
    """What viser prints of its start and end is left out: the address is told by us."""
    return contextlib.redirect_stdout(io.StringIO())


def start_server(port: int | None) -> Any:
    """A running `viser.ViserServer`. `port` None takes any free one.

    Raises `RetargetError` where viser is not installed, the port is taken, or viser's server cannot be guarded.
    """
    viser = require_viser()
    with quiet(), _guarded() as guarded:
        server = viser.ViserServer(host=HOST, port=port or 0, label="retarget", verbose=False)
        fault = None
        if port is not None and server.get_port() != port:  # viser goes on to the next free one
            fault = f"port {port} is taken; leave --port out for any free one"
        elif not guarded:
            fault = f"viser {viser.__version__} cannot be closed to other web pages; viser 1.1 can"
        if fault is not None:
            server.stop()
            raise RetargetError(fault)
    return server


def refusal(headers: Any) -> str | None:
    """Why a request is refused, from its headers (`websockets.datastructures.Headers`); None for one that is served."""
    hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
    if len(hosts) != 1 or not _is_local(f"http://{hosts[0]}"):
        return "this server answers to 127.0.0.1 and localhost only"
    if headers.get_all("Upgrade") and len(origins) != 1:
        return "a websocket must say which page opens it"
    if any(origin.lower() != f"http://{hosts[0].lower()}" for origin in origins):
        return "only this server's own page may connect"
    return None


def _is_local(address: str) -> bool:
    try:
        parts = urlsplit(address)
        return parts.hostname in NAMES and parts.netloc.lower().split(":")[0] == parts.hostname and parts.path == ""
    except ValueError:  # no address at all
        return False


@contextlib.contextmanager
def _guarded() -> Iterator[list[bool]]:
    """Let a server that viser starts in this block refuse what `refusal` says. viser has no setting for it, but starts its
    server through one function of the websockets package, which stands in its own thread before the start returns.
    Yields a list that is empty until then."""
    from websockets.asyncio import server as websockets

    serve, seen = websockets.serve, []

    def guarded(*args: Any, process_request: Any = None, **settings: Any) -> Any:
        def process(connection: Any, request: Any) -> Any:
            reason = refusal(request.headers)
            if reason is not None:
                return connection.respond(403, f"{reason}\n")
            return None if process_request is None else process_request(connection, request)

        seen.append(True)
        return serve(*args, process_request=process, **settings)

    with _STARTING:
        websockets.serve = guarded
        try:
            yield seen
        finally:
            websockets.serve = serve
