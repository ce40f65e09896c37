"""viser's server, for this user alone: on 127.0.0.1, and only below an address that nobody else knows.

viser serves its page and its websocket to whoever can reach the port, and that is every user of the machine. It has no
hook for a check of requests (1.1), so the websockets server that it starts is given one (see `_guarded_start`): a
request whose path does not begin with the token is refused before viser sees it. viser's page connects to where it came
from, path included, so that the token needs no change of the page.
"""

import contextlib
import http
import io
import secrets
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from types import ModuleType, SimpleNamespace
from typing import Any

from fenics_rom.errors import MissingPackageError, SceneError
from fenics_rom.visualization.optional_dependencies import viser_package

HOST = "127.0.0.1"
MAX_PORTS = 1000  # that are tried, one after the other

_starting = threading.Lock()


class Server:
    """A running viser server, its `port`, and its `address` for the browser, with the token.

    The port that is asked for is tried first; 0: any.

    Raises:
        MissingPackageError: there is no viser, or one that starts its server in another way, so that it cannot be
            guarded.
        SceneError: none of the ports is free.
    """

    def __init__(self, port: int):
        package = viser_package()
        token = secrets.token_urlsafe(16)
        # viser prints an address without the token.
        with _guarded_start(package, token) as guard, contextlib.redirect_stdout(io.StringIO()):
            self.viser = package.ViserServer(host=HOST, port=_free_port(port), verbose=False)
        if not guard.used:
            self.stop()
            raise MissingPackageError(
                f"the live view cannot refuse strangers with viser {package.__version__}: pip install viser==1.1.1"
            )
        self.port: int = self.viser.get_port()
        self.address = f"http://{HOST}:{self.port}/{token}/"

    def stop(self) -> None:
        """Ends the server; browsers see that it is gone."""
        with contextlib.redirect_stdout(io.StringIO()):  # viser says that it stopped
            self.viser.stop()


def _free_port(first: int) -> int:
    for candidate in range(first, min(first + MAX_PORTS, 2**16)):
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((HOST, candidate))
            except OSError:
                continue
            port: int = probe.getsockname()[1]
            return port
    raise SceneError(f"--port {first}: neither this port nor one of the {MAX_PORTS} after it is free")


class _Guard:
    """What viser sees in place of the library websockets while it starts its server: `serve` with a check of requests.

    The path of a request has to begin with the token. `used` tells whether viser has started a server by it.
    """

    def __init__(self, library: ModuleType, token: str):
        self._library, self._token, self.used = library, token, False
        self.asyncio = SimpleNamespace(server=SimpleNamespace(serve=self._serve))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._library, name)

    def _serve(self, *arguments: Any, process_request: Callable[..., Any], **options: Any) -> Any:
        self.used = True

        def check(connection: Any, request: Any) -> Any:
            begin, _, path = request.path.partition("?")[0].removeprefix("/").partition("/")
            if not secrets.compare_digest(begin.encode(), self._token.encode()):
                return connection.respond(
                    http.HTTPStatus.FORBIDDEN, "The address lacks the token that fenics-rom view has printed.\n"
                )
            request.path = f"/{path}"
            return process_request(connection, request)

        return self._library.asyncio.server.serve(*arguments, process_request=check, **options)


@contextlib.contextmanager
def _guarded_start(viser: Any, token: str) -> Iterator[_Guard]:
    """While it lasts, the server that viser starts refuses requests outside of /TOKEN/.

    viser (1.1) makes the request handler and calls websockets' `serve` in one function of its server thread: it takes
    no handler, gives no handle of the server before it listens, and binds TCP only, so that a proxy in front would
    leave its own port open. Therefore the name `websockets` in viser's module, and only there, means a guard during the
    start; the library itself is untouched, and the name is put back.
    """
    module = sys.modules[viser.infra.WebsockServer.__module__]
    with _starting:
        library = module.websockets
        guard = _Guard(library, token)
        module.websockets = guard  # type: ignore[attr-defined]
        try:
            yield guard
        finally:
            module.websockets = library  # type: ignore[attr-defined]
