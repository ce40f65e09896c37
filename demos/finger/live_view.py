"""Takes demos/finger/view.png, the picture of the live view, with a hand on the mouse of a real browser.

    python demos/finger/live_view.py     # half a minute; needs Chromium and playwright

The flexor is tightened on the page, then the finger is pulled up at its tip, while it rests on the three objects.
"""

import re
import subprocess
import sys
import tempfile
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

import fenics_rom as fr

HERE = Path(__file__).parent
SIZE = {"width": 1280, "height": 760}
SOFTWARE_GL = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
VIEWED = (100.0, 600.0), (140.0, 480.0)  # px: the camera goes below
PULLED = (700.0, 430.0), (760.0, 250.0)  # px: the lower side of the finger's end goes up


def main() -> None:
    """Makes the ROM, serves it, and photographs the page."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "finger.h5"
        fr.write_rom(file, fr.reduce(fr.assemble(fr.read_scene(HERE / "finger.toml"))))
        command = [sys.executable, "-u", "-m", "fenics_rom", "view", str(file), "--no-browser", "--port", "0"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as view:
            assert view.stdout is not None
            address = re.search(r"http://\S+", view.stdout.readline())
            assert address is not None
            with sync_playwright() as playwright:
                browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=SOFTWARE_GL)
                page = browser.new_page(viewport=SIZE)
                page.goto(address[0])
                photograph(page)
                browser.close()
            view.terminate()


def photograph(page: Page) -> None:
    """Works the page, and writes the picture."""
    page.get_by_text("flexor (N)").wait_for()
    page.locator(".mantine-Notification-closeButton").first.click()  # that there is no GPU
    page.wait_for_timeout(3000)
    tension = page.locator("input[type=text]").nth(1)  # air, flexor, ...
    tension.fill("1.6")
    tension.press("Enter")
    drag(page, VIEWED)
    page.mouse.up()
    page.mouse.move(*PULLED[0])
    page.wait_for_timeout(3000)
    drag(page, PULLED)
    page.wait_for_timeout(5000)
    page.screenshot(path=HERE / "view.png")
    page.mouse.up()


def drag(page: Page, way: tuple[tuple[float, float], tuple[float, float]]) -> None:
    """Presses the mouse at one point, px, and moves it to another one."""
    page.mouse.move(*way[0])
    page.mouse.down()
    page.mouse.move(*way[1], steps=5)


if __name__ == "__main__":
    main()
