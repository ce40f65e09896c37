"""What `fenics-rom view` does."""

import os
import sys
import tempfile
import webbrowser
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import fenics_rom as fr
from fenics_rom.errors import SceneError
from fenics_rom.io.hdf5 import content_of
from fenics_rom.visualization.viewer.live_body import LiveBody
from fenics_rom.visualization.viewer.live_page import LivePage
from fenics_rom.visualization.viewer.run_page import RunPage
from fenics_rom.visualization.viewer.server import Server, viser_package


def view(files: Sequence[Path], *, port: int, browser: bool, dt: float | None) -> None:
    """Serves a page for a ROM, a run or two runs until it is interrupted (Ctrl-C).

    Args:
        files: one ROM, or one or two runs.
        port: that is tried first.
        browser: whether to open one.
        dt: time step of a ROM instead of its scene's, s.

    Raises:
        SceneError: a ROM beside something else, something without a surface, or no port is free.
        CompareError: two runs of different bodies, or without common instants.
        MissingPackageError: there is no viser.
    """
    viser = viser_package()
    begin = _page(viser, files, dt)
    server = Server(port)
    page_file = None
    try:
        if server.port != port and port:
            print(f"port {port} is taken: {server.port} is used")
        print(f"{', '.join(map(str, files))}: {server.address}")
        print("Only who has this address gets in. End with Ctrl-C.", flush=True)
        page = begin(server.viser)
        if browser:
            page_file = _open(server.address)
        page.run()
    except KeyboardInterrupt:
        pass
    finally:
        server.stop()
        if page_file is not None:
            page_file.unlink(missing_ok=True)
    print("ended")


def _page(viser: Any, files: Sequence[Path], dt: float | None) -> Callable[[Any], Any]:
    """What makes the page, after all is read that could be wrong."""
    contents = [content_of(file) for file in files]
    if contents == ["rom"]:
        body = LiveBody(fr.read_rom(files[0]), dt)
        return lambda server: LivePage(viser, server, body, Path.cwd(), files[0].stem, _notify)
    if "rom" in contents:
        raise SceneError(f"{files[contents.index('rom')]}: is a ROM, and is viewed alone; runs are viewed beside runs")
    if dt is not None:
        raise SceneError("--dt is the time step of a ROM; the steps of a run are taken")
    runs = [fr.read_trajectory(file) for file in files]
    page = RunPage(viser, runs, [file.name for file in files])
    return page.show_on


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
