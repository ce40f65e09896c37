# %% First steps: from a mesh to a soft body in the browser.
"""Run it cell by cell in an editor that knows "# %%", or as a whole: .venv/bin/python demos/first_steps.py.

It writes into a folder first_steps where it is run.
"""

from pathlib import Path

import gmsh

import fenics_rom as fr

# %% A mesh: a tongue of 12 x 3 x 1 cm, and the face that will be held. Any .msh file of Gmsh does as well.
out = Path("first_steps")
out.mkdir(exist_ok=True)
gmsh.initialize()
gmsh.model.occ.addBox(0, 0, 0, 0.12, 0.03, 0.01)
gmsh.model.occ.synchronize()
gmsh.model.setPhysicalName(2, gmsh.model.addPhysicalGroup(2, [1]), "root")  # the face at x = 0
gmsh.model.setPhysicalName(3, gmsh.model.addPhysicalGroup(3, [1]), "body")
gmsh.option.setNumber("Mesh.MeshSizeMax", 0.008)
gmsh.model.mesh.generate(3)
gmsh.write(str(out / "tongue.msh"))
gmsh.finalize()

# %% A scene says what is simulated: material, supports, where the body can be touched, what is read, and a load.
scene = """
name = "tongue"
mesh = { file = "tongue.msh", degree = 2 }
material = { young = 0.2e6, poisson = 0.45, density = 1000.0 }   # Pa, -, kg/m3
supports = { clamped = ["root"] }
contacts.tip = { near = { point = [0.11, 0.015, 0.01], radius = 0.012 } }   # m
contacts.middle = { near = { point = [0.06, 0.015, 0.01], radius = 0.012 } }
outputs.end = { points = [[0.12, 0.015, 0.005]] }
effects = { inertia = {}, damping = { alpha = 0.5, beta = 2e-3 } }   # 1/s, s
run = { dt = 1e-3, duration = 1.0, load = [{ contact = "tip", stop = 0.3, force = [0.0, 0.0, 0.015] }] }   # s, N
"""
(out / "tongue.toml").write_text(scene)

# %% Assembled once, and reduced: order 20 for each contact mode, with a validation of what that leaves out.
system = fr.assemble(fr.read_scene(out / "tongue.toml"))
rom = fr.reduce(system, order=20)
fr.write_rom(out / "tongue.h5", rom)
print(rom.validation)

# %% The load history at both orders: how far they are apart, and how much faster the small one is.
full, reduced = fr.simulate(system), fr.simulate(rom, rate=True)
print(fr.compare(reduced, full)["shape"].relative, full.settings["seconds"] / reduced.settings["seconds"])

# %% Pictures: what the contact modes are, and how energy and the tongue's end move.
fr.export(rom, out / "modes.png")
fr.export(reduced, out / "tongue.gif")
fr.plot({"full": full, "reduced": reduced}, out / "run.pdf")

# %% And now push it: the browser opens, and Ctrl-C ends it.
fr.view(rom)
