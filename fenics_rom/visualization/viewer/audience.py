"""The browsers, and whether they have taken in the last picture.

viser keeps all pictures that a browser has not drawn yet, and takes in those of one moment at once: the mesh that is
shown would be one that is not read (see coloured_body.py). So the next picture waits for the slowest browser. viser
(1.1) tells none that a browser is done; but what a browser is asked for it answers in order, after the picture.
"""

import math
import threading
import time
from contextlib import suppress
from typing import Any

PATIENCE_SECONDS = 2.0  # for a browser that does not answer, as in a window that is put to sleep; then for none of it
QUESTION = "picture"  # in the browser's storage, where nothing is


class Audience:
    """All browsers on a viser server."""

    def __init__(self, server: Any):
        self._server = server
        self._asked: dict[int, float] = {}  # when, of browsers that have not answered
        self._answered = threading.Event()

    def is_ready(self) -> bool:
        """Whether there is a browser, and none that the next picture has to wait for."""
        clients, now = self._server.get_clients(), time.perf_counter()
        waiting = [client for client in clients if now - self._asked.get(client, -math.inf) < PATIENCE_SECONDS]
        return bool(clients) and not waiting

    def ask(self) -> None:
        """After a picture: it is sent now, and all are asked whether they have it."""
        self._answered.clear()
        self._server.flush()
        for number, client in self._server.get_clients().items():
            if number not in self._asked:
                self._asked[number] = time.perf_counter()
                threading.Thread(target=self._await_answer, args=(number, client), daemon=True).start()

    def _await_answer(self, number: int, client: Any) -> None:
        with suppress(RuntimeError):  # it went away, or keeps no storage
            client.local_storage.get_item(QUESTION)
        self._asked.pop(number, None)
        self._answered.set()

    def wait(self, seconds: float) -> None:
        """Until one has answered, but not longer than this."""
        self._answered.wait(max(seconds, 0.0))
        self._answered.clear()
