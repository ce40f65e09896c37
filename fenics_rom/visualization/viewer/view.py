"""A ROM or a world live, or runs, on a page in the browser."""

import atexit
import os
import sys
import tempfile
import threading
import webbrowser
from collections.abc import Callable, Sequence
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any

from fenics_rom.compilation import compiled
from fenics_rom.errors import SceneError
from fenics_rom.io.given import object_or_file
from fenics_rom.lazy_import import load
from fenics_rom.rom.file import ROM_FILE
from fenics_rom.rom.rom import Rom
from fenics_rom.run import is_world_file
from fenics_rom.scene.world_format import WorldScene
from fenics_rom.trajectory.file import RUN_FILE
from fenics_rom.trajectory.trajectory import Trajectory
from fenics_rom.visualization.optional_dependencies import viser_package
from fenics_rom.visualization.viewer.live_body import LiveBody
from fenics_rom.visualization.viewer.live_page import LivePage
from fenics_rom.visualization.viewer.live_world import LiveWorld
from fenics_rom.visualization.viewer.run_page import RunPage
from fenics_rom.visualization.viewer.server import Server
from fenics_rom.visualization.viewer.world_page import WorldPage
from fenics_rom.world.world import World

Model = Rom | Trajectory | World | WorldScene | str | PathLike[str]
Page = LivePage | RunPage | WorldPage

FRAME_PIXELS = 600  # height of the page in a notebook


def view(
    model: Model,
    reference: Trajectory | str | PathLike[str] | None = None,
    *,
    dt: float | None = None,
    port: int = 8080,
    browser: bool = True,
    wait: bool | None = None,
) -> "View":
    """Shows a ROM or a world live, to be pulled with the mouse, or a run, alone or beside what it is measured against.

    Args:
        model: a ROM, a world or a run, or the name of its file. A world begins anew, and is itself left as it is.
        reference: another run of the same body, or the name of its file.
        dt: time step of a ROM or a world instead of its scene's, s.
        port: that is tried first; 0: any.
        browser: whether to open one; a notebook shows the page below its cell instead.
        wait: whether to go on until Ctrl-C before it returns; None: not in a notebook or another interactive session.

    Returns:
        The view, which goes on beside the program until it is closed; where it was waited for, it is.

    Raises:
        SceneError: what was given cannot be viewed, or no port is free.
        FileError: a file cannot be read.
        CompareError: two runs of different bodies, or without common instants.
        StepError: dt is not a positive finite number, or the body begins in an obstacle.
        MissingPackageError: there is no viser.

    Example:
        >>> with fr.view(rom, port=0, browser=False, wait=False) as page:
        ...     print(page)
        View at http://127.0.0.1:...; close() ends it
    """
    viser = viser_package()
    models = [model] if reference is None else [model, reference]
    begin = _page(viser, models, dt)
    server = Server(port)
    try:
        shown = View(server, begin(server.viser))
    except BaseException:
        server.stop()
        raise
    waits = not (hasattr(sys, "ps1") or sys.flags.interactive) if wait is None else wait
    if waits:
        if server.port != port and port:
            print(f"port {port} is taken: {server.port} is used")
        print(f"{', '.join(map(_name, models))}: {server.address}")
        print("Only who has this address gets in. End with Ctrl-C.", flush=True)
    if browser and "ipykernel" not in sys.modules:
        shown.open()
    if waits:
        shown.wait()
        print("ended")
    else:
        shown.start()
    return shown


class View:
    """A page in the browser, until it is closed.

    Attributes:
        address: for a browser on this machine; only who has it gets in.
    """

    def __init__(self, server: Server, page: Page):
        self.address = server.address
        self._server, self._page, self._ended = server, page, threading.Event()
        self._thread = threading.Thread(target=page.run, args=(self._ended,), daemon=True)
        self._leads_here: Path | None = None
        atexit.register(self.close)

    def open(self) -> None:
        """Opens a browser, where there is a screen."""
        self._leads_here = _open(self.address)

    def start(self) -> None:
        """Goes on beside the program."""
        self._thread.start()

    def wait(self) -> None:
        """Goes on until Ctrl-C, and is closed then."""
        try:
            self._page.run(self._ended)
        except KeyboardInterrupt:
            pass
        finally:
            self.close()

    def close(self) -> None:
        """Ends it; what was being recorded is written."""
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join()
        self._server.stop()
        if self._leads_here is not None:
            self._leads_here.unlink(missing_ok=True)
        atexit.unregister(self.close)

    def __enter__(self) -> "View":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"View at {self.address}; {'closed' if self._ended.is_set() else 'close() ends it'}"

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        return f'<iframe src="{self.address}" width="100%" height="{FRAME_PIXELS}" style="border: 0"></iframe>'


def _page(viser: Any, models: Sequence[Model], dt: float | None) -> Callable[[Any], Page]:
    """What makes the page, after all is looked at that could be wrong."""
    worlds = [model for model in models if _is_world(model)]
    if worlds:
        if len(models) > 1:
            raise SceneError(f"{_name(worlds[0])}: is a world, and is viewed alone; runs are viewed beside runs")
        live, name = _live_world(worlds[0], dt)
        if compiled():
            live.take_first_steps()
        return lambda server: WorldPage(viser, server, live, name)
    given = [object_or_file("view", model, ROM_FILE, RUN_FILE) for model in models]
    roms = [name for name, one in zip(map(_name, models), given, strict=True) if isinstance(one, Rom)]
    if roms and len(given) > 1:
        raise SceneError(f"{roms[0]}: is a ROM, and is viewed alone; runs are viewed beside runs")
    if roms:
        body = LiveBody(given[0], dt)
        if compiled():
            body.take_first_steps()
        return lambda server: LivePage(viser, server, body, Path.cwd(), Path(roms[0]).stem, _notify)
    if dt is not None:
        raise SceneError("--dt is the time step of a ROM; the steps of a run are taken")
    return RunPage(viser, given, [_name(model) for model in models]).show_on


def _is_world(model: Model) -> bool:
    if isinstance(model, str | PathLike):
        return Path(model).suffix == ".toml" and is_world_file(model)
    return isinstance(model, World | WorldScene)


def _live_world(model: Any, dt: float | None) -> tuple[LiveWorld, str]:
    """A live world, and its name."""
    if isinstance(model, World):
        live = LiveWorld(model)
        if dt is not None:
            live.dt = dt
        return live, "world"
    if not isinstance(model, WorldScene):
        model = load("scene.world_file", "read_world")(model)
    make_world, inputs_at = (load("world_run", name) for name in ("make_world", "inputs_at"))  # which need pydantic
    return LiveWorld(make_world(model, dt), partial(inputs_at, model)), model.file.name


def _name(model: Model) -> str:
    """What it is called on the page."""
    if isinstance(model, World | WorldScene):
        return "world" if isinstance(model, World) else model.file.name
    return model.name if isinstance(model, Rom | Trajectory) else Path(model).name


def _notify(words: str) -> None:
    print(words, flush=True)


def _open(address: str) -> Path | None:
    """Opens a browser, where there is a screen, and returns the file that led it to the address.

    Everybody can read the words that a program was started with, so the browser is not given the address but a file
    that only this user can read, which leads to it.
    """
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        print("there is no display: open the address yourself", flush=True)
        return None
    with tempfile.NamedTemporaryFile("w", prefix="fenics-rom-", suffix=".html", delete=False) as page:  # mode 0600
        page.write(f'<meta http-equiv="refresh" content="0; url={address}"><a href="{address}">the body</a>')
    if not webbrowser.open(Path(page.name).as_uri()):
        print("no browser could be opened: open the address yourself", flush=True)
    return Path(page.name)
