"""viser's server, for this user alone: on 127.0.0.1, and only below an address that nobody else knows.

viser serves its page and its websocket to whoever can reach the port, and that is every user of the machine. It has no
hook for a check of requests (1.1), so the websockets server that it starts is given one: a request whose path does
not begin with the token is refused before viser sees it. viser's page connects to where it came from, path included,
so that the token needs no change of the page.
"""

import contextlib
import http
import io
import secrets
import socket
import threading
from collections.abc import Callable, Iterator
from typing import Any

from fenics_rom.errors import MissingPackageError, SceneError

HOST = "127.0.0.1"
PORTS = 1000  # that are tried, one after the other

_patched = threading.Lock()


def viser_package() -> Any:
    """The package viser, worth asking for before long work.

    Raises:
        MissingPackageError: it is not installed.
    """
    try:
        import viser
    except ModuleNotFoundError as error:
        raise MissingPackageError(
            f"the live view needs {error.name}, which this Python lacks: pip install fenics-rom[view]"
        ) from error
    return viser


class Server:
    """A running viser server.

    Args:
        port: that is tried first; 0: any.

    Attributes:
        viser: its handle.
        port: where it listens.
        address: for the browser, with the token.

    Raises:
        MissingPackageError: there is no viser.
        SceneError: none of the ports is free.
    """

    def __init__(self, port: int):
        package = viser_package()
        token = secrets.token_urlsafe(16)
        with _guarded(token), contextlib.redirect_stdout(io.StringIO()):  # viser prints an address without the token
            self.viser = package.ViserServer(host=HOST, port=_free_port(port), verbose=False)
        self.port: int = self.viser.get_port()
        self.address = f"http://{HOST}:{self.port}/{token}/"

    def stop(self) -> None:
        """Ends the server; browsers see that it is gone."""
        with contextlib.redirect_stdout(io.StringIO()):  # viser says that it stopped
            self.viser.stop()


def _free_port(first: int) -> int:
    for port in range(first, min(first + PORTS, 2**16)):
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((HOST, port))
            except OSError:
                continue
            found: int = probe.getsockname()[1]
            return found
    raise SceneError(f"--port {first}: neither this port nor one of the {PORTS} after it is free")


@contextlib.contextmanager
def _guarded(token: str) -> Iterator[None]:
    """While it lasts, websockets servers that are started refuse requests outside of /TOKEN/."""
    import websockets.asyncio.server as library

    with _patched:
        serve = library.serve

        def guarded(*arguments: Any, process_request: Callable[..., Any], **options: Any) -> Any:
            def check(connection: Any, request: Any) -> Any:
                begin, _, path = request.path.partition("?")[0].removeprefix("/").partition("/")
                if not secrets.compare_digest(begin.encode(), token.encode()):
                    return connection.respond(
                        http.HTTPStatus.FORBIDDEN, "The address lacks the token that fenics-rom view has printed.\n"
                    )
                request.path = f"/{path}"
                return process_request(connection, request)

            return serve(*arguments, process_request=check, **options)

        library.serve = guarded  # type: ignore[assignment,misc]
        try:
            yield
        finally:
            library.serve = serve  # type: ignore[misc]
