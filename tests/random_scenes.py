"""`python tests/random_scenes.py COUNT [--seed FIRST]`: exact laws of random products of all that a body can have.

Of each scene that `drawn_scenes.py` draws from a seed
- the energy account closes, reduced and at full order;
- momenta stay where nothing acts from outside;
- reduced in all modes and points it moves as at full order does, until a difference of round-off grows by itself;
- a restored state goes on to the bit, a rollout is steps, and a batch is single bodies;
- nothing is raised but the package's own errors. Which these are is counted.
"""

import argparse
import re
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import gmsh
import numpy as np
import pytest
import scipy.linalg
from all_points import all_points
from bodies import dense
from drawn_scenes import STEPS, Drawn, drawn

import fenics_rom as fr
from fenics_rom.errors import FenicsRomError
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.mechanics.contact import ContactSolution
from fenics_rom.reduction.hyperreduction import reduce as hyperreduction
from fenics_rom.scene import foreign_file, foreign_process
from fenics_rom.scene.file import parse_scene

Array = np.ndarray

ACCOUNT = 1e-11  # of the turnover, and of momenta
BY_NEWTON = 1e-10  # the same where full order solves a step by Newton's method, to 1e-12 of the forces or round-off
SAME = 1e-9  # of the largest displacement: two programs of the same equations
ROUND_OFF = 1e-12  # change of what moves a body, by which is seen how a difference of round-off grows
GROWTH = 1e3  # by how much more two programs may differ than that change does
MEANINGLESS = 1e-3  # of the largest displacement: from there on an event is decided by round-off, in either program
HALVED = 4.0  # differences by which halves of steps differ from whole ones, which are as large for other steps
WAVERING = 0.05  # of the largest power of friction, or an impact's speed: by W, not quite A⁻¹, it may be none
TOGETHER = 1e-5  # of forces of contact that a batch finds for all bodies at once, see mechanics/batch_contact_solver.py
EPS = np.finfo(float).eps
ORDER = 6


@dataclass
class Outcome:
    """What became of a scene: laws that it broke, uses that were refused, laws that were looked at."""

    broken: list[str] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
    kept: list[str] = field(default_factory=list)

    def judge(self, law: str, missed: float, allowed: float) -> None:
        """Notes whether a law is kept."""
        if missed <= allowed:
            self.kept.append(law)
        else:
            self.broken.append(f"{law}: {missed:.2g}, allowed {allowed:.2g}")


def outcome(seed: int, folder: Path) -> Outcome:
    """Of the scene of a seed."""
    scene, found = drawn(seed, folder), Outcome()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with noted("assembly", found):
            system = fr.assemble(parse_scene(scene.text))
            for law in (_whole_laws, _reduced_laws):
                with noted(law.__name__[1:], found):
                    law(scene, system, found)
    return found


@contextmanager
def noted(name: str, found: Outcome) -> Iterator[None]:
    """Notes what is raised, the package's own errors as refusals."""
    try:
        yield
    except FenicsRomError as error:
        found.refused.append(f"{name}: {type(error).__name__}: {error}")
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        found.broken.append(f"raised {type(error).__name__}: {error} at {place.filename}:{place.lineno}")


def _whole_laws(scene: Drawn, system: fr.System, found: Outcome) -> None:
    """At full order, and reduced in all modes and points."""
    rom = in_all_modes(system)
    stepper = exact_stepper(scene)
    runs = []
    for share, parts in ((1.0, 1), (1 + ROUND_OFF, 1), *[(1.0, 2)] * is_stepped_otherwise(scene)):
        body = fr.Simulator(rom, scene.dt / parts, signals=scene.signals, stepper=stepper)
        begin(body, scene, share)
        runs.append(run(body, scene, share, parts))
    full = FullOrderSimulator(system, scene.dt, system.scene.environment, scene.signals)
    with closing(full):
        begin_whole(full, scene, rom)
        whole = run(full, scene)
    reduced, changed, *halved = runs
    reduced.judge("all modes", scene, found)
    whole.judge("full order", scene, found)
    count = min(len(each.shapes) for each in (reduced, changed, whole, *halved))
    count = min([count, *reduced.not_alike[:1], *whole.not_alike[:1], *reduced.wavers_beside(whole)])
    if not count or (halved and scene.touches):  # halves of steps meet obstacles at other times
        return
    size = np.maximum.accumulate([np.abs(x).max() for x in reduced.shapes[:count]])
    size += 1e-5 * np.abs(system.body.nodes).max()  # of smaller motions round-off of places shows
    grown = np.maximum.accumulate(reduced.beside(changed, count) / size)
    parted = reduced.beside(whole, count) / size
    allowed = np.maximum(SAME, GROWTH * grown)
    if halved:
        allowed += HALVED * np.maximum.accumulate(reduced.beside(halved[0], count) / size)
    is_told = allowed <= MEANINGLESS
    worst = np.argmax(np.where(is_told, parted / allowed, 0.0))
    found.judge(f"full order (step {worst + 1} of {count})", parted[worst], allowed[worst])


def exact_stepper(scene: Drawn) -> str | None:
    """That of full order."""
    return "newton" if "large" in scene.law and scene.has_inertia else None


def is_stepped_otherwise(scene: Drawn) -> bool:
    """Whether full order takes steps of another kind: in world axes, where the reduced body takes them in its frame."""
    return scene.frame == "free" and "large" in scene.law


def in_all_modes(system: fr.System) -> fr.Rom:
    """The ROM in all eigenvectors, and in all points of its material where it deforms largely."""
    order = system.elastic_size
    if system.deformation is None:
        rom = fr.reduce(system, order=order, method="modal")
        return replace(rom, residual_compliance=None)  # which round-off alone would be
    seen = hyperreduction.BASES["modal+derivatives"]

    def every_mode(problem, checkpoint):
        M, K = (dense(matrix, problem.system.size) for matrix in (problem.system.mass, problem.system.stiffness))
        γ, V = scipy.linalg.eigh((K + K.T) / 2, (M + M.T) / 2)
        return replace(seen(problem, checkpoint), columns=V[:, len(γ) - order :])

    with pytest.MonkeyPatch.context() as patched, all_points():
        patched.setitem(hyperreduction.BASES, "modal+derivatives", every_mode)
        rom = fr.reduce(system, order=order, method="modal+derivatives")
    return replace(rom, deformation=replace(rom.deformation, trained=None), residual_compliance=None)


def begin(body: fr.Simulator, scene: Drawn, share: float = 1.0) -> None:
    """Throws a body, and moves it in its lowest eigenvectors, of the same signs whatever the eigensolver gave."""
    if scene.start is not None:
        body.place(started(body, scene, share))
    if scene.speed:
        q, r = body.state
        first = body.rom.rigid if scene.frame == "held" else 0
        lowest = body.rom.basis @ body.model.coordinates[:, first : first + 3]
        signs = np.sign(np.random.default_rng(8).standard_normal(len(lowest)) @ lowest)
        r[first : first + 3] = share * scene.speed * np.sqrt(body.rom.node_mass.sum()) * signs * [0.5, 0.3, 0.2]
        body.state = q, r


def started(body: fr.Simulator, scene: Drawn, share: float = 1.0) -> fr.BaseState:
    """Where a free body starts."""
    origin = body.rom.moving_frame.origin
    return scene.start._replace(position=origin, velocity=share * scene.start.velocity)


def begin_whole(full: FullOrderSimulator, scene: Drawn, rom: fr.Rom) -> None:
    """The same of a body at full order."""
    twin = fr.Simulator(rom, scene.dt, signals=scene.signals, stepper=exact_stepper(scene))
    begin(twin, scene)
    if scene.start is not None:
        full.stepper.place(started(twin, scene))
    q, r = twin.state
    put = getattr(full.stepper, "set_shape", full.stepper.set_state)  # in the frame
    unknowns = full.system.body.unknowns
    own = np.isin(unknowns.moving, unknowns.free)  # of a rigid surface others follow
    put(*((twin.rom.basis @ (twin.model.coordinates @ part))[own] for part in (q, r)))


@dataclass
class Run:
    """What a body did: its displacements (N, 3) after each step, m, and how far its laws missed.

    Attributes:
        not_alike: steps in which obstacles press a point from several sides, so that their forces and friction are any
            of many, or that were taken in parts, which are other steps.
    """

    shapes: list[Array] = field(default_factory=list)
    not_alike: list[int] = field(default_factory=list)
    error: str = ""
    stopped: list[tuple[bytes, float]] = field(default_factory=list)  # see stopped_by_friction, of each step
    asked: list[tuple[Array, Array]] = field(default_factory=list)  # see asked_otherwise, of each step
    missed: float = 0.0  # of the account, J
    turnover: float = 0.0  # J
    moved: float = 0.0  # of momenta, of those at the start

    def beside(self, other: "Run", count: int) -> Array:
        """Largest differences of displacements after each of so many steps, (count,), m."""
        return np.array([np.abs(x - y).max() for x, y in zip(self.shapes[:count], other.shapes, strict=False)])

    def wavers_beside(self, other: "Run") -> list[int]:
        """The first step in which others are stopped there, or are asked otherwise, and that is a near thing."""
        stops = zip(self.stopped, other.stopped, strict=False)
        other_stops = [a[0] != b[0] and min(a[1], b[1]) <= WAVERING for a, b in stops]
        asked_else = []
        for (is_so, near), (others, others_near) in zip(self.asked, other.asked, strict=False):
            differ = is_so != others
            asked_else.append(np.minimum(near, others_near)[differ].min(initial=np.inf) <= WAVERING)
        return np.flatnonzero(np.logical_or(other_stops, asked_else))[:1].tolist()

    def judge(self, name: str, scene: Drawn, found: Outcome) -> None:
        """Notes whether its laws are kept."""
        if self.error:
            found.refused.append(f"{name}: {self.error}")
        allowed = BY_NEWTON if name == "full order" and "large" in scene.law else ACCOUNT
        smallest = EPS * scene.modulus if "large" in scene.law else 0.0  # energies of strains are differences of such
        found.judge(f"account, {name}", self.missed, allowed * self.turnover + smallest)
        if scene.is_alone:
            found.judge(f"momentum, {name}", self.moved, allowed)


def run(body, scene: Drawn, share: float = 1.0, parts: int = 1) -> Run:
    """A run as far as it goes, with shares of the inputs, and each step taken in so many parts."""
    done, stored, start, booked = Run(), body.energy, body.momentum, _sums(body)
    scale = max(np.linalg.norm(part) for part in start) if scene.is_alone else 0.0
    try:
        for step in range(STEPS):
            for _ in range(parts):
                advance(body, scene, step, share)
            now = _sums(body)
            done.turnover = max(done.turnover + np.abs(now - booked).sum(), body.energy)
            done.missed, booked = max(done.missed, abs(body.energy - stored - now @ [1, -1, -1, -1])), now
            done.shapes.append(body.displacement().copy())
            of_body = body.integrator if isinstance(body, fr.Simulator) else body.stepper
            stepper = getattr(of_body, "kernel", of_body)
            is_cut = getattr(stepper, "parted", 0) or getattr(stepper, "notes", {}).get("cut", 0)
            contact = stepper.contact
            done.stopped.append(stopped_by_friction(of_body.interface))
            done.asked.append(asked_otherwise(of_body.interface))
            if is_cut or (contact is not None and is_wedged(contact, "rigid = " in scene.text)):
                done.not_alike.append(step)
            if scene.is_alone:
                gone = [np.abs(a - b).max() / scale for a, b in zip(body.momentum, start, strict=True)]
                done.moved = max(*gone, done.moved)
    except FenicsRomError as error:
        done.error = f"{type(error).__name__}: {error}"
    return done


def stopped_by_friction(interface) -> tuple[bytes, float]:
    """Which pairs friction may not stop in the last step, and its power on the others, of the largest it could have."""
    solved = None if interface is None else interface.solver.last_step()[1]
    if solved is None or solved.pairs.braking is None:
        return b"", np.inf
    helped, sliding, friction = solved.pairs.braking.helped, solved.problem.sliding, solved.forces[1:]
    most = (np.linalg.norm(friction, axis=0) * np.linalg.norm(sliding, axis=0)).sum()
    power = abs((friction * (solved.velocities[1:] + sliding)).sum())
    return b"" if helped is None else np.flatnonzero(helped).tobytes(), power / most if most > 0 else np.inf


def asked_otherwise(interface) -> tuple[Array, Array]:
    """What pairs (O P,) are asked for that is a choice of two, and how near they were to the other, as a share.

    These are those that leave again after an impact (what would be back within the step is pressed), then those that
    are so deep inside that they are let out without a push; see `NormalRule.of`.
    """
    if interface is None:
        return np.zeros(0, bool), np.zeros(0)
    solver, (pairs, solved) = interface.solver, interface.solver.last_step()
    e, count = solver.law.restitution, len(solver.obstacles) * len(solver.points)
    is_so, near = np.zeros(2 * count, bool), np.full(2 * count, np.inf)
    if pairs is None or solver.law.stiffness is not None:
        return is_so, near
    approach, free = pairs.relative[0], pairs.free[0]
    if 0 < e < 1:
        is_so[:count] = (approach < 0) & np.isclose(pairs.target, (1 - e) / 2 * approach, rtol=1e-9, atol=0.0)
        limit = (1 + e) * np.minimum(approach, -1e-30)
        near[:count] = np.abs(free / limit - 1)
    if solved is not None and not solved.quasi_static:
        is_so[count:] = (solved.gaps < 0) & (pairs.target == 0) & (approach < 0)
        near[count:] = 0.0  # what it would do without contact decides, and a first sweep says that
    return is_so, near


def is_wedged(contact: ContactSolution, is_rigid: bool) -> bool:
    """Whether several obstacles push one point, or what may be a rigid surface."""
    pushing = contact.pairs[np.abs(contact.pair_forces).max(axis=1, initial=0.0) > 0]
    obstacles, points = np.divmod(pushing, len(contact.forces))
    return len(set(points.tolist())) < len(points) or (is_rigid and len(set(obstacles.tolist())) > 1)


def _sums(body) -> Array:
    """Supplied, dissipated, lost, numerical."""
    return np.array([total + rest for total, rest in body.ledger.sums[:4]])


def advance(body, scene: Drawn, step: int, share: float = 1.0) -> None:
    """Takes a step of a body."""
    if not scene.touches:
        body.switch(mode_of(step))
    body.step(share * inputs(scene)[step])


def mode_of(step: int) -> str:
    """The contact mode that a body is in that nothing touches."""
    return ("tip", "under")[step // 9 % 2]


def inputs(scene: Drawn) -> Array:
    """Of each step: of actuators alone where obstacles say which contact mode is active."""
    return scene.pulls if scene.touches else np.hstack([scene.pushes, scene.pulls])


def _reduced_laws(scene: Drawn, system: fr.System, found: Outcome) -> None:
    """Of a ROM of few modes: what every use of it keeps."""
    rom = fr.reduce(system, order=ORDER, method="modal" if system.deformation is None else "modal+derivatives")
    made = {"signals": scene.signals, "stepper": scene.stepper}

    def body() -> fr.Simulator:
        made_new = fr.Simulator(rom, scene.dt, **made)
        begin(made_new, scene)
        return made_new

    first = run(body(), scene)
    first.judge("reduced", scene, found)
    _restored(body(), scene, found, len(first.shapes))
    if not first.error:
        _rolled_out(body(), body(), scene, found)
        if scene.stepper is None:
            _batched(body(), scene, found)


def _restored(body: fr.Simulator, scene: Drawn, found: Outcome, steps: int) -> None:
    """Half of the run twice."""
    half, ends = steps // 2, []
    for step in range(half):
        advance(body, scene, step)
    saved = body.save()
    for _ in range(2):
        body.restore(saved)
        for step in range(half, steps):
            advance(body, scene, step)
        ends.append([*np.concatenate(body.state), body.energy, *_sums(body), *np.ravel(body.pose and body.pose[0])])
    found.judge("restored", 0.0 if ends[0] == ends[1] else 1.0, 0.0)


def _rolled_out(body: fr.Simulator, twin: fr.Simulator, scene: Drawn, found: Outcome) -> None:
    """A rollout beside steps, in one contact mode."""
    body.rollout(inputs(scene))
    for u in inputs(scene):
        twin.step(u)
    _alike("rollout", body.displacement(), twin.displacement(), SAME, twin, found)


def _batched(single: fr.Simulator, scene: Drawn, found: Outcome) -> None:
    """The second of two bodies of a batch beside a single one."""
    bodies = fr.Batch(single.rom, 2, scene.dt, signals=scene.signals)
    is_joint = bodies.stepping == "together"  # as it begins: switches may end that
    if scene.start is not None:
        bodies.place(started(single, scene))
    if scene.speed:
        bodies.set_state(*single.state)
    for step in range(STEPS):
        if not scene.touches:
            single.switch(mode_of(step))
            bodies.switch(single.contact)
        u = inputs(scene)[step]
        bodies.step(np.concatenate([np.zeros(bodies.inputs - len(u)), u]))
        advance(single, scene, step)
    allowed = TOGETHER if is_joint and scene.touches else SAME
    _alike("batch", bodies.shape(1), single.displacement(), allowed, single, found)
    if not is_joint:
        ends = [[*bodies.state()[k][1], *single.state[k]] for k in range(2)]
        found.judge(
            "batch to the bit", 0.0 if all(end[: len(end) // 2] == end[len(end) // 2 :] for end in ends) else 1.0, 0.0
        )


def _alike(law: str, one: Array, other: Array, allowed: float, body: fr.Simulator, found: Outcome) -> None:
    size = np.abs(other).max() + 1e-5 * np.abs(body.rom.nodes).max()
    found.judge(law, np.abs(one - other).max() / size, allowed)


def read_here(file: Path) -> dict[str, Array]:
    """What is in a mesh file."""
    try:
        return foreign_process.read_arrays(str(file))
    finally:
        gmsh.finalize()


def outcomes(count: int, first: int) -> Iterator[tuple[int, Outcome]]:
    """Of scenes of seeds from the first on; meshes are read in this process, which saves a third of a second each."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(foreign_file, "read_arrays", read_here)
        for seed in range(first, first + count):
            with tempfile.TemporaryDirectory() as folder:
                yield seed, outcome(seed, Path(folder))


def main() -> int:
    """Counts outcomes, and shows the scenes that break a law."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("count", type=int)
    parser.add_argument("--seed", type=int, default=1, help="of the first scene")
    given = parser.parse_args()
    kept, refused, broken, start = Counter(), Counter(), {}, time.monotonic()
    examples = {}
    for seed, found in outcomes(given.count, given.seed):
        kept.update(law.split(" (")[0] for law in found.kept)
        for message in found.refused:
            message = re.sub(r"[-+]?[0-9][0-9.e+-]*", "#", message)[:220]
            refused[message] += 1
            examples.setdefault(message, seed)
        if found.broken:
            broken[seed] = found.broken
            scene = drawn(seed, Path(tempfile.gettempdir()))
            print(
                f"seed {seed} ({scene.frame}, {scene.law}, {scene.contact}, dt {scene.dt:.2g})",
                *found.broken,
                sep="\n  ",
            )
        if (seed - given.seed) % 20 == 19:
            print(f"{seed - given.seed + 1} scenes, {time.monotonic() - start:.0f} s, {len(broken)} broken", flush=True)
    print("kept:", *(f"{count} {law}" for law, count in sorted(kept.items())), sep="\n  ")
    print("refused:", *(f"{n} (seed {examples[m]}) {m}" for m, n in refused.most_common()), sep="\n  ")
    print(f"{len(broken)} of {given.count} scenes break a law: seeds {list(broken)}")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
