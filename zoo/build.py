"""Makes the files of the zoo, and measures their errors: python zoo/build.py [NAME ...]; needs FEniCSx.

Each body gets a folder in fenics_rom_zoo, with its ROM, its scene, and what that reads; the world too, if it has one.
catalogue.json says what there is, with the errors measured against full order. It exits with 1 where one of them is
larger than bodies.toml allows.
"""

import argparse
import json
import re
import shutil
import sys
import tomllib
import warnings
from pathlib import Path
from typing import Any

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning

HERE = Path(__file__).resolve().parent
PACKAGE = HERE / "fenics_rom_zoo"
BODIES: dict[str, Any] = tomllib.loads((HERE / "bodies.toml").read_text("utf-8"))
TOLD = ("title", "use", "source", "licence")
LARGEST = 30e6  # bytes of all files
READ = re.compile(r'"([^"\n]*\.(?:msh|csv))"')  # what a scene or a world names


def main() -> None:
    """Makes those that are named, or all."""
    parser = argparse.ArgumentParser(description="Make the zoo.")
    parser.add_argument("names", metavar="NAME", nargs="*", help=f"of {', '.join(BODIES)}; else all")
    parser.add_argument("--package", type=Path, default=PACKAGE, help="folder in which to make them")
    choice = parser.parse_args()
    if unknown := set(choice.names) - set(BODIES):
        parser.error(f"there is no {', '.join(sorted(unknown))}; there is {', '.join(BODIES)}")
    warnings.simplefilter("ignore", FenicsRomWarning)  # ROMs and runs hold them
    exceeded = make(choice.names or list(BODIES), choice.package)
    size = sum(file.stat().st_size for file in choice.package.rglob("*"))
    print(f"{size / 1e6:.1f} MB")
    if exceeded or size > LARGEST:
        sys.exit(f"errors beyond their bounds: {', '.join(exceeded) or 'none'}; use {LARGEST / 1e6:g} MB")


def make(names: list[str], package: Path) -> list[str]:
    """Makes these bodies in the folder of the package; the errors that are beyond their bounds."""
    package.mkdir(exist_ok=True)
    if package != PACKAGE:
        shutil.copy(PACKAGE / "__init__.py", package)
    catalogue = package / "catalogue.json"
    made = json.loads(catalogue.read_text("utf-8")) if catalogue.exists() else {}
    exceeded = []
    for name in names:
        made[name] = made_of(BODIES[name], package / name)
        errors, bounds = made[name]["errors"], BODIES[name]["bounds"]
        print(f"{name}: {', '.join(f'{what} {error:.1e}' for what, error in errors.items())}", flush=True)
        exceeded += [f"{name}, {what}" for what in errors if not errors[what] <= bounds.get(what, 0.0)]
        ordered = {body: made[body] for body in BODIES if body in made}
        catalogue.write_text(json.dumps(ordered, indent=2) + "\n", "utf-8")
    return exceeded


def made_of(body: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Makes the folder of a body, which is called as the body is; what the catalogue says of it."""
    name = folder.name
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    files = {"rom": folder / f"{name}.h5", "scene": copied(HERE / body["scene"], folder / f"{name}.toml")}
    scene = fr.read_scene(files["scene"])
    assert scene.run is not None
    system = fr.assemble(scene)
    fr.write_rom(files["rom"], fr.reduce(system, order=body.get("order"), method=body.get("method")))
    rom = fr.read_rom(files["rom"])
    if "world" in body:
        files["world"] = copied(HERE / body["world"], folder / body["world"])
        fr.simulate(files["world"])  # it runs
    told = {what: body[what] for what in TOLD}
    told |= {what: file.relative_to(folder.parent).as_posix() for what, file in files.items()}
    run = f"{scene.run.duration:g} s in steps of {scene.run.dt:g} s"
    order = max(mode.order for mode in rom.contact_models.values())
    return {**told, "unknowns": system.size, "order": order, "run": run, "errors": errors_of(rom, system)}


def copied(source: Path, to: Path) -> Path:
    """A scene or a world in a folder of the zoo, with the meshes and tables that it names beside it."""
    text = source.read_text("utf-8")
    for named in READ.findall(text):
        shutil.copy(source.parent / named, to.parent)
    to.write_text(READ.sub(lambda match: f'"{Path(match[1]).name}"', text), "utf-8")
    return to


def errors_of(rom: fr.Rom, system: fr.System) -> dict[str, float]:
    """Of small shapes at rest under each input, and over the scene's run: of the whole shape, of outputs and forces."""
    found = fr.compare(fr.simulate(rom), fr.simulate(system))
    static = [mode.static_error for mode in rom.contact_models.values() if mode.static_error is not None]
    errors = {"static": max(static), "shape": found["elastic shape" if "elastic shape" in found else "shape"].relative}
    for what, begin in (("outputs", "output "), ("force", "force of ")):
        if several := [difference.relative for key, difference in found.items() if key.startswith(begin)]:
            errors[what] = max(several)
    return errors


if __name__ == "__main__":
    main()
