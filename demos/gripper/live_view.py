"""Two soft fingers and a box in the browser: tighten the fingers by the sliders, and pull the box out with the mouse.

    python demos/gripper/live_view.py               # until Ctrl-C
    python demos/gripper/live_view.py --picture     # takes demos/gripper/view.png; needs Chromium and playwright

The fingers stand still, so that all runs in real time on one core.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from gripper import ASIDE, DENSITY, DT, EDGE, GRAVITY, HEIGHT, SIDES, TENSION, still
from playwright.sync_api import Page, sync_playwright

import fenics_rom as fr
from fenics_rom.mechanics.frame_motion import quaternion_of
from fenics_rom.world.shapes import Box, HalfSpace

HERE = Path(__file__).parent
SIZE = {"width": 1280, "height": 760}
SOFTWARE_GL = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
PULLED = (462.0, 480.0), (560.0, 540.0)  # px: the box, towards the right


def main() -> None:
    """Shows it, or takes the picture."""
    parser = argparse.ArgumentParser(description="A soft gripper in the browser.")
    parser.add_argument("--picture", action="store_true", help="write view.png, and end")
    if not parser.parse_args().picture:
        fr.view(standing_gripper())
        return
    with fr.view(standing_gripper(), port=0, browser=False, wait=False) as view, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=SOFTWARE_GL)
        page = browser.new_page(viewport=SIZE)
        page.goto(view.address)
        photograph(page)
        browser.close()


def standing_gripper() -> fr.World:
    """Two fingers that hang above a box on the ground, open."""
    scene = fr.read_scene(HERE / "finger.toml")
    scene = replace(scene, frame="fixed", effects=replace(scene.effects, gravity=None))
    rom = fr.reduce(fr.assemble(scene))
    bodies: dict[str, fr.RigidBody | fr.SoftBody] = {
        "ground": fr.RigidBody(HalfSpace(), motion=still()),
        "box": fr.RigidBody(Box((EDGE,) * 3), density=DENSITY, position=(0, 0, EDGE / 2)),
    }
    for side, sign in SIDES.items():
        mount = quaternion_of(np.array([[0, 0, sign], [0, sign, 0], [-1, 0, 0]], dtype=float))
        bodies[side] = fr.SoftBody(rom, position=(sign * ASIDE, 0, HEIGHT), rotation=mount)
    apart = [list(SIDES), ["ground", *SIDES]]
    return fr.World(bodies, DT, gravity=(0, 0, -GRAVITY), friction=0.8, apart=apart)


def photograph(page: Page) -> None:
    """Works the page, and writes the picture."""
    page.get_by_text("left flexor (N)").wait_for()
    page.locator(".mantine-Notification-closeButton").first.click()  # that there is no GPU
    for number in range(len(SIDES)):
        tension = page.locator("input[type=text]").nth(number)
        tension.fill(str(TENSION))
        tension.press("Enter")
    page.wait_for_timeout(6000)
    page.mouse.move(*PULLED[0])
    page.wait_for_timeout(1000)
    page.mouse.down()
    page.mouse.move(*PULLED[1], steps=5)
    page.wait_for_timeout(6000)
    page.screenshot(path=HERE / "view.png")
    page.mouse.up()


if __name__ == "__main__":
    main()
