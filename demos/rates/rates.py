"""What a step costs: rates of all ways to step, on one thread, each beside its error.

    python demos/rates/rates.py                 # some minutes
    python demos/rates/rates.py --quick         # short loops and a coarse mesh, to see that it works

A rate says little on a busy machine, and a ratio of rates much: what is compared runs in turns in one process, and the
best of several rounds counts. The script

1. compares a step with the bare matrix product that it cannot do without;
2. takes many steps at once, under known inputs;
3. steps many bodies at once;
4. compares with the full order, as bare as can be: the paper's cylinder, one solve with a kept factor and the products
   M v and K x a step;
5. looks for memory that stays;
6. compares what the runtime takes to import with what NumPy and h5py take.

Models of order 20 and 40 are of the cylinder. Beyond, its Hankel singular values are exhausted, and models are of
random bases: for what a step costs that is no matter. Everything is written to demos/rates/out/, with --quick to
out/quick/. The checks at the end are on errors, memory and ratios of rates; with --quick not on the latter.
"""

import argparse
import gc
import json
import os
import statistics
import subprocess
import sys
import tracemalloc
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "scaling"))

from cylinder import PAPER
from findings import Findings, rates, readable, resident
from models import FORCE, OUTPUT, STEP, BareFourCalls, BareProduct, FullBare, FullCarried, cylinder, midpoint, synthetic

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning
from fenics_rom.fem.linear_stepper import FullOrderStepper
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.batch import Batch

OUT = Path(__file__).parent / "out"
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}

COARSE = 2.0  # size factor of a mesh of 1,700 unknowns
CONTACTS = 4
ORDERS = (20, 40)
BEYOND = (78, 164)  # synthetic
ORDER = 40  # of everything but section 1
BODIES = 1024
SIZES = (256, 1024, 4096)
POOL = 8  # arrays of inputs that a batch gets in turn
CHECKED = 1000  # steps after which states are compared
LENGTHS = (100, 1000, 10_000)  # of rollouts
MANY = {"step": 10**6, "step, ledger": 10**6, "rollout": 10**7, "batch": 10**7}  # body-steps that must leak nothing
KEPT = 2048  # bytes: NumPy and Python keep some small blocks for the next array
TRACED = 4  # times that a loop runs to see what stays
LEAK = 200_000  # bytes
ROUNDS = 21
BARE_READING = """
with open({0!r}, "rb") as file:
    hashlib.sha256(file.read()).digest()
with h5py.File({0!r}) as h5:
    h5.visititems(lambda name, item: item[()] if isinstance(item, h5py.Dataset) else None)
"""
PRESSED, RUN = 750, 1500  # steps of the comparison with the full order, and of the push in it

Array = np.ndarray


def main() -> None:
    """Runs the demo."""
    parser = argparse.ArgumentParser(description="Measures what a step costs.")
    parser.add_argument("--quick", action="store_true", help="short loops and a coarse mesh; rates are not judged")
    quick = parser.parse_args().quick
    if not ONE_THREAD.items() <= os.environ.items():  # read when NumPy is loaded, so it takes another start
        os.execve(sys.executable, [sys.executable, *sys.argv], os.environ | ONE_THREAD)
    out = OUT / "quick" if quick else OUT  # so that a test does not overwrite what took minutes
    out.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter("ignore", FenicsRomWarning)  # these tetrahedra lock, which is no matter here

    factor = COARSE if quick else PAPER
    system = cylinder(out / f"cylinder_{factor:g}.msh", factor, CONTACTS)
    roms = {order: fr.reduce(system, order=order) for order in ORDERS} | {order: synthetic(order) for order in BEYOND}
    rom = roms[ORDER]
    load = f"load {os.getloadavg()[0]:.1f} at the start"
    machine = f"{processor()}, one thread, {load}. Cylinder: {system.size:,} unknowns."
    print(f"{machine}\n")

    findings = Findings(judge_rates=not quick)
    by_order = single_steps(roms, findings, quick)
    rollouts(rom, findings, quick)
    batches(rom, findings, quick)
    share = full_order(system, rom, findings, quick)
    what_stays(rom, findings, quick)
    pair = replace(system, contacts=dict(list(system.contacts.items())[:2]))
    imports([fr.reduce(pair, order=ORDER), rom], out, findings, quick)
    held = findings.verdict()
    (out / "rates.md").write_text("\n".join([f"{machine}\n", *findings.tables]))
    (out / "rates.json").write_text(json.dumps(findings.numbers, indent=1))
    picture(by_order, share, system.size, out / "rates.png")
    if not held:
        sys.exit(1)


def processor() -> str:
    """What the machine calls its processor."""
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    return next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), "unknown processor")


def pushes(steps: int, *bodies: int) -> Array:
    """Random forces, (steps, ..., 3) N."""
    return FORCE * np.random.default_rng(steps).standard_normal((steps, *bodies, 3))


def few(steps: int) -> list[Array]:
    """As many forces, of which a hundred are different: more would not stay in the cache."""
    return list(pushes(100)) * (steps // 100)


def first(rom: Rom) -> ContactModel:
    """The contact mode that a simulator begins in."""
    return next(iter(rom.contact_models.values()))


def state(mode: ContactModel, q: Array, r: Array) -> Array:
    """[ω q, r] (2m,)."""
    return np.concatenate([np.sqrt(mode.eigenvalues) * q, r])


def distance(values: Array, reference: Array) -> float:
    """Largest distance of the two at any instant, as a share of the largest that the reference gets to."""
    gaps, sizes = (np.linalg.norm(part.reshape(len(part), -1), axis=1) for part in (values - reference, reference))
    return float(gaps.max() / sizes.max())


def stepping(step: Callable[[Array], object], inputs: list[Array]) -> Callable[[], int]:
    """A loop over inputs."""

    def loop() -> int:
        for u in inputs:
            step(u)
        return len(inputs)

    return loop


def running(run: Callable[[list[Array]], None], inputs: list[Array]) -> Callable[[], int]:
    """What has a loop of its own."""

    def loop() -> int:
        run(inputs)
        return len(inputs)

    return loop


def rolling_out(rom: Rom, steps: int, length: int, every: int, ledger: bool) -> Callable[[], int]:
    """Rollouts of that length, one after the other, with one point read."""
    body, inputs = fr.Simulator(rom, STEP, ledger=ledger), pushes(length)

    def loop() -> int:
        for _ in range(steps // length):
            body.rollout(inputs, every=every, outputs=[OUTPUT])
        return steps // length * length

    return loop


def many(batch: Batch, steps: int, reading: bool) -> Callable[[], int]:
    """Steps of a batch, counted by bodies, each under inputs that are not the last ones."""
    pool = list(pushes(POOL, batch.size).astype(batch.dtype))

    def loop() -> int:
        for k in range(steps):
            batch.step(pool[k % POOL])
            if reading:
                batch.displacement(OUTPUT)
        return steps * batch.size

    return loop


def single_steps(roms: dict[int, Rom], findings: Findings, quick: bool) -> dict[str, dict[int, float]]:
    """Section 1: rates of all forms by order, and their errors."""
    rows: list[tuple[object, ...]] = []
    by_form: dict[str, dict[int, float]] = {}
    steps, rounds = (200, 1) if quick else (4_000, ROUNDS)
    inputs, checked = few(steps), pushes(CHECKED)
    largest = gap = 0.0
    for order, rom in roms.items():
        mode = first(rom)
        exact = midpoint(mode, checked)
        product, calls = BareProduct(mode), BareFourCalls(mode)
        plain, booked = (fr.Simulator(rom, STEP, ledger=ledger) for ledger in (False, True))
        rolled_out, batch = fr.Simulator(rom, STEP, ledger=False), Batch(rom, 2, STEP)
        product.steps(list(checked))
        calls.run(list(checked))
        rolled_out.rollout(checked)
        for u in checked:
            plain.step(u)
            booked.step(u)
            batch.step(u)
        ends = {
            "bare product": product.state.copy(),
            "four calls, bare": calls.state.copy(),
            "step": state(mode, *plain.state),
            "step, ledger": state(mode, *booked.state),
            "rollout": state(mode, *rolled_out.state),
            f"batch of {BODIES:,}": state(mode, *(part[0] for part in batch.state(0))),
        }
        errors = {name: float(np.linalg.norm(end - exact) / np.linalg.norm(exact)) for name, end in ends.items()}
        account = booked.ledger
        assert account is not None
        gap = max(gap, abs(booked.energy - account.supplied + account.dissipated) / account.supplied)
        largest = max(largest, *errors.values())
        loops = {
            "bare product": running(product.run, inputs),
            "four calls, bare": running(calls.run, inputs),
            "step": stepping(plain.step, inputs),
            "step, ledger": stepping(booked.step, inputs),
            "rollout": rolling_out(rom, 5 * steps, 5 * steps, 1, False),
            f"batch of {BODIES:,}": many(Batch(rom, BODIES, STEP), max(1, steps // 100), False),
        }
        found = rates(loops, rounds)
        for name, rate in found.items():
            by_form.setdefault(name, {})[order] = rate
            findings.numbers.setdefault(name, {})[str(order)] = rate
            times = found["bare product"] / rate
            rows.append((order, name, f"{rate:,.0f}", f"{1e6 / rate:.3g} µs", f"{times:.2g}", f"{errors[name]:.1e}"))
        if order == ORDER:
            ratio = found["bare product"] / found["step"]
            findings.at_most(f"order {order}: a step, in bare products", ratio, 2, rate=True)
        else:  # where a call of Python takes as long as the product, or one product is not the fastest way
            ratio = found["four calls, bare"] / found["step"]
            findings.at_most(f"order {order}: a step, in four bare calls", ratio, 1.5, rate=True)
        ratio = found["step"] / found["step, ledger"]
        findings.at_most(f"order {order}: a step with ledger, in steps without", ratio, 2, rate=True)
    findings.at_most(f"error of any form after {CHECKED:,} steps", largest, 1e-11)
    findings.at_most("gap of the energy account, as a share of the work", gap, 1e-12)
    heading = ("order", "form", "body-steps per second", "each", "in bare products", f"error after {CHECKED:,} steps")
    findings.table("## Forms of a step: 3 inputs; rollout and batch with 3 outputs and none", heading, rows)
    return by_form


def rollouts(rom: Rom, findings: Findings, quick: bool) -> None:
    """Section 2: many steps under known inputs at once, and as many one by one."""
    cases = {(length, every, False) for length in LENGTHS for every in (1, 10)}
    cases |= {(LENGTHS[-1], every, True) for every in (1, 10)}
    steps, rounds = (LENGTHS[-1], 1) if quick else (2 * LENGTHS[-1], ROUNDS)
    ordered = sorted(cases, key=lambda case: (case[2], case[1], case[0]))
    loops = {case: rolling_out(rom, steps, *case) for case in ordered}
    stepper = fr.Simulator(rom, STEP, ledger=False)
    found = rates({"step": stepping(stepper.step, few(steps // 5))} | {str(c): loops[c] for c in ordered}, rounds)

    inputs = pushes(LENGTHS[-1])
    body, read = fr.Simulator(rom, STEP), []
    for u in inputs:
        body.step(u)
        read.append(body.displacement(OUTPUT))
    stepped, largest = np.array(read), 0.0
    rows: list[tuple[object, ...]] = []
    for case in ordered:
        length, every, ledger = case
        body = fr.Simulator(rom, STEP, ledger=ledger)
        parts = [body.rollout(inputs[k : k + length], every=every)[OUTPUT] for k in range(0, len(inputs), length)]
        error = distance(np.concatenate(parts), stepped[every - 1 :: every])
        largest = max(largest, error)
        rate, kept = found[str(case)], "yes" if ledger else "no"
        rows.append((f"{length:,}", every, kept, f"{rate:,.0f}", f"{rate / found['step']:.1f}", f"{error:.1e}"))
        findings.numbers.setdefault("rollout against step", {})[str(case)] = rate / found["step"]
        if length == LENGTHS[-1] and not ledger:
            what = f"a rollout of {length:,} steps, outputs after every {every}: times the rate of step"
            findings.at_least(what, rate / found["step"], 10, rate=True)
    findings.at_most("error of rollouts against stepping", largest, 1e-11)
    heading = ("steps of a rollout", "outputs after every", "ledger", "steps per second", "times step", "error")
    title = (
        f"## Rollout, order {ORDER}, 3 inputs, 3 outputs; step, no ledger and no outputs: {found['step']:,.0f} a second"
    )
    findings.table(title, heading, rows)


def batches(rom: Rom, findings: Findings, quick: bool) -> None:
    """Section 3: many bodies at once, and one."""
    steps, rounds = (2_000, 1) if quick else (100_000, ROUNDS)
    stepper = fr.Simulator(rom, STEP, ledger=False)
    loops = {"step": stepping(stepper.step, few(steps // 20))}
    errors = {}
    for dtype in (np.float64, np.float32):
        for size in SIZES:
            for modes in (1, len(rom.contact_models)):
                for reading in (False, True):
                    case = f"{size},{dtype.__name__},{modes},{reading}"
                    batch = spread(rom, size, dtype, modes)
                    loops[case] = many(batch, max(1, steps // size), reading)
                errors[case.rsplit(",", 1)[0]] = error_of_batch(rom, spread(rom, size, dtype, modes))
    found = rates(loops, rounds)
    rows: list[tuple[object, ...]] = []
    for size in SIZES:
        for name in ("float64", "float32"):
            for modes in (1, len(rom.contact_models)):
                key = f"{size},{name},{modes}"
                plain, read = (found[f"{key},{reading}"] for reading in (False, True))
                times = [f"{rate / found['step']:.1f}" for rate in (plain, read)]
                rates_shown = [f"{rate:,.0f}" for rate in (plain, read)]
                rows.append((f"{size:,}", name, modes, *rates_shown, *times, f"{errors[key]:.1e}"))
                findings.numbers.setdefault("batch against step", {})[key] = plain / found["step"]
                findings.numbers.setdefault("batch, reading, against step", {})[key] = read / found["step"]
    for name, bound in (("float64", 1e-11), ("float32", 1e-3)):
        one, four = (
            [found[f"{size},{name},{modes},False"] for size in SIZES] for modes in (1, len(rom.contact_models))
        )
        shares = [of_four / of_one for of_one, of_four in zip(one, four, strict=True)]
        what = f"batches of {SIZES[0]} to {SIZES[-1]:,}, {name}"
        # Where steps of one body come to the speed of their matrix product, a batch has little but its calls to save.
        findings.at_least(f"{what}: times the rate of step, the least", min(one) / found["step"], 10, rate=True)
        findings.at_least(
            f"{what}: rate in four contact modes, of that in one, the least", min(shares), 0.25, rate=True
        )
        largest = max(error for key, error in errors.items() if name in key)
        findings.at_most(f"{what}: error against stepping", largest, bound)
    heading = (
        *("bodies", "numbers", "contact modes", "body-steps per second", "with 3 outputs each"),
        *("times step", "with 3 outputs each", "error"),
    )
    title = f"## Batches, order {ORDER}, 3 inputs, new ones each step; step: {found['step']:,.0f} a second"
    findings.table(title, heading, rows)


def spread(rom: Rom, size: int, dtype: type, modes: int) -> Batch:
    """A batch in some contact modes, drawn for each body."""
    batch = Batch(rom, size, STEP, dtype=dtype)
    names = list(rom.contact_models)[:modes]
    batch.switch([names[k] for k in np.random.default_rng(size).integers(modes, size=size)])
    return batch


def error_of_batch(rom: Rom, batch: Batch) -> float:
    """Against simulators of five of its bodies, by their outputs over 200 steps."""
    chosen = np.linspace(0, batch.size - 1, 5).astype(int)
    bodies = []
    for name in batch.contact[chosen]:
        bodies.append(fr.Simulator(rom, STEP, ledger=False))
        bodies[-1].switch(str(name))
    pool = pushes(POOL, batch.size)
    ours, reference = [], []
    for k in range(200):
        batch.step(pool[k % POOL].astype(batch.dtype))
        ours.append(batch.displacement(OUTPUT)[chosen])
        for body, u in zip(bodies, pool[k % POOL, chosen], strict=True):
            body.step(u)
        reference.append([body.displacement(OUTPUT) for body in bodies])
    return max(distance(a, b) for a, b in zip(*(np.swapaxes(part, 0, 1) for part in (ours, reference)), strict=True))


def full_order(system: fr.System, rom: Rom, findings: Findings, quick: bool) -> float:
    """Section 4: the full order, bare, and what is lost without it. Returns its rate as a share of step's."""
    contact = next(iter(rom.contact_models))
    steps, rounds = (5, 1) if quick else (50, ROUNDS)
    short, long = list(pushes(steps)), few(40 * steps if quick else 400 * steps)  # turns of about the same time
    solvers = {"CHOLMOD": ("cholmod",), "PETSc's own Cholesky": ("petsc", "rcm"), "MUMPS": ("mumps",)}
    stepped = {f"full order, {name}": FullBare(system, *choice) for name, choice in solvers.items()}
    carried = FullCarried(system, "cholmod")
    refined, B = FullOrderStepper(system, STEP), system.input_matrix(contact)
    plain = fr.Simulator(rom, STEP, ledger=False)
    loops = {name: running(partial(body.run, contact), short) for name, body in stepped.items()}
    loops |= {
        "full order, CHOLMOD, M v and K x carried along": running(partial(carried.run, contact), short),
        "full order, solve, refined": stepping(lambda u: refined.step_under(B @ u), short),
        "step": stepping(plain.step, long),
        "rollout": rolling_out(rom, 5 * len(long), 5 * len(long), 1, False),
    }
    found = rates(loops, rounds)
    refined.close()
    best = max(found[name] for name in stepped)
    errors = {
        "one contact mode": trajectory_error(system, rom, [contact] * RUN),
        "with a switch": trajectory_error(
            system, rom, [contact] * (RUN // 3) + [list(rom.contact_models)[1]] * (RUN // 3 * 2)
        ),
    }
    rows: list[tuple[object, ...]] = []
    for name, rate in found.items():
        error = "" if "full" in name else f"{errors['one contact mode']:.1e}"
        rows.append(
            (name, f"{system.size if 'full' in name else ORDER:,}", f"{rate:,.0f}", readable(rate / best), error)
        )
    title = (
        f"## Against the full order of {system.size:,} unknowns, one core\n\nFull-order steps are one solve with a "
        "kept factor and two products; carrying M v and K x along saves one of them, and solve refines them. "
        "Error: of the whole shape against the full "
        f"order, in the mass norm, over {RUN:,} steps of push and release; when the contact mode changes under way, to "
        f"a patch 0.2 m along, {errors['with a switch']:.1e}."
    )
    findings.table(title, ("model", "order", "steps per second", "times full order", "error"), rows)
    findings.numbers["full order"] = found | {f"error, {name}": error for name, error in errors.items()}
    findings.at_least("step: times the rate of the full order", found["step"] / best, 500, rate=True)
    findings.at_least("rollout: times the rate of the full order", found["rollout"] / best, 5000, rate=True)
    findings.at_most("error of push and release against the full order", errors["one contact mode"], 1e-6)
    return best / found["step"]


def trajectory_error(system: fr.System, rom: Rom, contacts: list[str]) -> float:
    """Of the whole shape over the whole run, against the full order, in the mass norm; released half-way or later."""
    released = PRESSED if len(set(contacts)) == 1 else RUN // 3 * 2
    full, body = FullBare(system, "cholmod"), fr.Simulator(rom, STEP)
    gaps = sizes = 0.0
    for k, contact in enumerate(contacts):
        u = np.array([0.0, FORCE, FORCE]) * (k < released)
        body.switch(contact)
        body.step(u)
        full.run(contact, [u])
        shape = rom.basis @ (rom.contact_models[contact].coordinates @ body.state[0])
        both = np.stack([shape - full.x, full.x], axis=1)
        gap, size = np.einsum("nk,nk->k", both, system.mass @ both)
        gaps, sizes = gaps + gap, sizes + size
    return float(np.sqrt(gaps / sizes))


def what_stays(rom: Rom, findings: Findings, quick: bool) -> None:
    """Section 5: memory that is still there after many steps."""
    steps = 2_000 if quick else 10_000
    plain, booked = (fr.Simulator(rom, STEP, ledger=ledger) for ledger in (False, True))
    inputs = few(steps)
    loops = {
        "step": stepping(plain.step, inputs),
        "step, ledger": stepping(booked.step, inputs),
        "rollout": rolling_out(rom, steps, 1000, 1, True),
        "batch": many(spread(rom, 256, np.float64, len(rom.contact_models)), steps, True),
    }
    rows: list[tuple[object, ...]] = []
    for name, loop in loops.items():
        traced = traced_growth(loop)
        findings.at_most(f"{name}: bytes that stay after {TRACED} times {steps:,} steps", traced, KEPT)
        taken: object = "not in this run"
        grown: object = ""
        if not quick:
            before, counted = resident(), 0
            while counted < MANY[name]:
                counted += loop()
            growth = resident() - before
            taken, grown = f"{counted:,}", f"{growth / 1e3:,.0f} kB"
            findings.at_most(f"{name}: bytes by which the process grows in {counted:,} body-steps", growth, LEAK)
        rows.append((name, f"{traced:,} B", taken, grown))
    heading = ("", f"stays after {TRACED} times {steps:,} steps", "body-steps of the long run", "growth of the process")
    findings.table("## Memory", heading, rows)


def traced_growth(loop: Callable[[], int]) -> int:
    """Bytes that Python and NumPy hold after some loops and did not before, when it has run twice already."""
    tracemalloc.start()
    try:
        held = []
        for _ in range(2 + TRACED):
            loop()
            gc.collect()
            held.append(tracemalloc.get_traced_memory()[0])
        return held[-1] - held[1]
    finally:
        tracemalloc.stop()


def imports(roms: list[Rom], out: Path, findings: Findings, quick: bool) -> None:
    """Section 6: seconds until a ROM file is read, in fresh interpreters that take turns.

    A file cannot be read sooner than its bytes are checked and its arrays are copied, so that this is beside it.
    """
    base, runtime = "NumPy and h5py", "fenics_rom.runtime, which waits with h5py until a file is read"
    statements = {base: "import numpy, h5py", runtime: "import fenics_rom.runtime.simulator"}
    bare = list[str]()
    for rom in roms:
        file = out / f"{len(rom.contact_models)}.h5"
        fr.write_rom(file, rom)
        size = f"{file.stat().st_size / 1e6:.1f} MB"
        bare.append(f"NumPy and h5py, SHA-256 and arrays of a file of {size}")
        statements[bare[-1]] = f"{statements[base]}, hashlib\n{BARE_READING.format(str(file))}"
        name = f"the runtime, and a ROM of {len(rom.contact_models)} contact modes, {size}"
        statements[name] = f"{statements[runtime]}\nfenics_rom.read_rom({str(file)!r})"
    timed = "import time\nstart = time.perf_counter()\n{}\nprint(time.perf_counter() - start)"
    compiled = {"PYTHONDONTWRITEBYTECODE": "", "PYTHONPYCACHEPREFIX": str(out / "bytecode")}
    seconds: dict[str, list[float]] = {name: [] for name in statements}
    for round in range(3 if quick else 16):
        for name, statement in statements.items():
            command = [sys.executable, "-c", timed.format(statement)]
            done = subprocess.run(command, capture_output=True, text=True, check=True, env=os.environ | compiled)
            if round:  # the first one compiled what was not, as installing does
                seconds[name].append(float(done.stdout))
    least = {name: min(each) for name, each in seconds.items()}
    rows: list[tuple[object, ...]] = [
        (name, f"{1e3 * best:.0f} ms", f"{1e3 * statistics.median(seconds[name]):.0f} ms", f"{best / least[base]:.2f}")
        for name, best in least.items()
    ]
    findings.table("## Import, by fresh interpreters without their start", ("", "best", "median", "times"), rows)
    findings.numbers["imports"] = least
    findings.at_most("the runtime, in imports of NumPy and h5py", least[runtime] / least[base], 1.5, rate=True)
    paper = list(least.values())[3] / least[bare[0]]  # two contact modes
    findings.at_most("the runtime and a ROM of the paper's size, in bare readings of its file", paper, 1.5, rate=True)


def picture(by_form: dict[str, dict[int, float]], share: float, size: int, file: Path) -> None:
    """Body-steps per second of all forms against the order, and of the full order by its share of what step makes."""
    styles: dict[str, dict[str, object]] = {  # from the fastest down
        f"batch of {BODIES:,}": {"color": "C1", "marker": "D"},
        "rollout": {"color": "C2", "marker": "^"},
        "bare product": {"color": "0.5", "marker": "s", "linestyle": ":"},
        "step": {"color": "C0", "marker": "o"},
        "step, ledger": {"color": "C0", "marker": "o", "linestyle": "--", "markerfacecolor": "white"},
    }
    figure, axes = plt.subplots(figsize=(8, 4.5), layout="constrained")
    for name, style in styles.items():
        axes.loglog(*zip(*by_form[name].items(), strict=True), label=name, **style)
    step = by_form["step"][ORDER]
    full = share * step  # both change with the machine's load, and their ratio does not
    axes.axhline(full, color="crimson", label=f"full order, {size:,} unknowns")
    axes.annotate("", (ORDER, step), (ORDER, full), arrowprops={"arrowstyle": "<->", "color": "0.3", "shrinkB": 6})
    axes.annotate(f"{1 / share:,.0f} times", (1.04 * ORDER, np.sqrt(step * full)), fontsize=9, color="0.3")
    orders = [*ORDERS, *BEYOND]
    axes.set_xticks(orders, map(str, orders))
    axes.minorticks_off()
    axes.grid(linewidth=0.4)
    axes.set(xlabel="order m of the reduced model", ylabel="body-steps per second, one thread")
    axes.legend(loc="center left", bbox_to_anchor=(1, 0.5), frameon=False)
    figure.savefig(file, dpi=130)
    plt.close(figure)


if __name__ == "__main__":
    main()
