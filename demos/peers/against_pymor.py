"""The same reduction by pyMOR: what each takes, how good the models are, and what else its reductors make.

pyMOR's `SOBTfvReductor` projects as this project does, on directions from the position Gramians, so for one contact
mode the models should be equally good: that is a check, and not a merit. The cylinder is assembled here and its
matrices are handed to pyMOR, which runs by itself (environments.py). Inputs are forces on two contact patches, outputs
the mean displacements of the patches: six numbers. (The whole shape, which is what counts here as a rule, would be as
many outputs to pyMOR as there are unknowns.)
"""

import json
import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from cylinder import mesh, places, scene
from environments import Found, PeerError, ask
from findings import Findings
from scipy.linalg import eigh
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import splu
from turns import ROUNDS, machine, medians

import fenics_rom as fr
from fenics_rom.runtime.switching import Projections

ORDERS = (6, 12, 24, 40)
FEW = 20  # order of the variants and of the steps
FREQUENCIES = 2 * np.pi * np.concatenate([[0.0], np.geomspace(0.5, 500, 16)])  # rad/s; the lowest resonance is at 2 Hz
OURS = {"fenics_rom, for the outputs": "outputs", "fenics_rom, for the whole shape": "mass"}  # weighting
AS_IT_COMES, BEST = "pyMOR as it comes", "pyMOR, its best settings"
SETTINGS: dict[str, dict[str, Any]] = {  # of the Lyapunov solver: of 1 to 8 columns for the shifts these took the least
    AS_IT_COMES: {"settings": {}, "projection": "bfsr"},
    BEST: {
        "settings": {
            "pc_lr": {"projection_shifts_subspace_columns": 4, "adi_maxiter": 150},
            "po_lr": {"projection_shifts_subspace_columns": 2, "adi_maxiter": 150},
        },
        "projection": "sr",
    },
}
CONVERGED = {kind: {"projection_shifts_subspace_columns": k} for kind, k in (("pc_lr", 4), ("po_lr", 2))}
STABLE_AT = (10, 20, 30, 40)  # orders at which the variants are looked at
VARIANTS = ("SOBTfv", "SOBTp", "SOBTv", "SOBTpv", "SOBTvp", "SOBT")
PROJECTIONS = ("bfsr", "sr", "biorth")
STEP, STEPS = 1e-3, 2000  # s
INPUT = (0.01, 0.0, 0.0)  # N
BODIES = 1024
PARITY = 1.05  # times the other's error
SLOWER = {AS_IT_COMES: 10, BEST: 3}  # times our time, at least

Array = np.ndarray
Bases = dict[tuple[str, int], Array]  # by contact mode and order
Responses = dict[str, list[Array]]  # (K + iωD - ω²M)⁻¹ B by contact mode, at FREQUENCIES


@dataclass(frozen=True)
class Model:
    """The cylinder's matrices in SciPy's formats; the outputs Cᵀx are the mean displacements of the contact patches."""

    M: csr_matrix
    D: csr_matrix
    K: csr_matrix
    inputs: dict[str, Array]
    C: Array

    def write(self, file: Path) -> None:
        """To a file that needs nothing but NumPy to be read."""
        parts = {
            f"{a}_{part}": getattr(getattr(self, a), part) for a in "MDK" for part in ("data", "indices", "indptr")
        }
        np.savez(file, C=self.C, **parts, **{f"B_{name}": B for name, B in self.inputs.items()})

    def responses(self) -> Responses:
        """Frequency responses, by full solves."""
        found: Responses = {name: [] for name in self.inputs}
        for ω in FREQUENCIES:
            factor = splu((self.K + 1j * ω * self.D - ω**2 * self.M).tocsc())
            for name, B in self.inputs.items():
                found[name].append(factor.solve(B.astype(complex)))
        return found


def cylinder(factor: float, out: Path) -> fr.System:
    """The cylinder with two contact modes; `factor` is of the mesh size."""
    file = out / f"cylinder_{factor:g}.msh"
    mesh(file, factor)
    return fr.assemble(scene(file, places(2)))


def matrices(system: fr.System) -> Model:
    """What is given to pyMOR."""
    M, D, K = (
        csr_matrix(operator.mat.getValuesCSR()[::-1], shape=(system.size, system.size))
        for operator in (system.mass, system.damping, system.stiffness)
    )
    inputs = {name: system.input_matrix(name) for name in system.contacts}
    return Model(M, D, K, inputs, np.hstack(list(inputs.values())))


def compare(system: fr.System, interpreter: Path | PeerError, out: Path, findings: Findings, rounds: int) -> None:
    """All of it, or what can be said without pyMOR.

    Args:
        system: the cylinder.
        interpreter: of an environment with pyMOR, or why there is none.
        out: where files go.
        findings: where tables, numbers and claims go.
        rounds: of the timings.
    """
    model = matrices(system)
    given = out / "cylinder.npz"
    model.write(given)
    full = model.responses()
    watched = replace(system, outputs={"patches": model.C})
    asked = Peer(interpreter, given, out)
    offline(watched, model, full, asked, findings, rounds)
    pair = variants(watched, model, full, asked, findings)
    stepping(watched, model, pair, asked, findings)


@dataclass(frozen=True)
class Peer:
    """pyMOR, if there is one."""

    interpreter: Path | PeerError
    given: Path
    out: Path

    def __call__(self, task: dict[str, Any], given: Path | None = None) -> Found:
        """What pyMOR finds.

        Raises:
            PeerError: there is none, or it failed.
        """
        if isinstance(self.interpreter, PeerError):
            raise self.interpreter
        return ask(self.interpreter, "pymor_worker.py", given or self.given, self.out / "pymor.npz", task)


def offline(system: fr.System, model: Model, full: Responses, peer: Peer, findings: Findings, rounds: int) -> None:
    """Section 1: time and error of one-sided models of both contact modes."""
    seconds: dict[str, list[float]] = {label: [] for label in (*OURS, *SETTINGS)}
    bases: dict[str, Bases] = {label: {} for label in OURS}
    missing, blocks, versions = {}, {}, ""
    for label, weighting in OURS.items():
        for order in ORDERS:
            bases[label] |= ours(system, order, weighting)
    for _ in range(rounds):
        for label, weighting in OURS.items():
            start = time.perf_counter()
            ours(system, ORDERS[-1], weighting)
            seconds[label].append(time.perf_counter() - start)
        for label, settings in SETTINGS.items():
            try:
                found = peer({"what": "bases", "order": ORDERS[-1]} | settings)
            except PeerError as why:
                missing[label] = str(why)
                continue
            seconds[label].append(sum(float(value) for key, value in found.items() if key.startswith("seconds_")))
            bases[label] = {(name, r): found[f"basis_B_{name}"][:, :r] for name in model.inputs for r in ORDERS}
            blocks[label] = [int(found[f"columns_pc_B_{name}"]) for name in model.inputs]
            blocks[label].append(int(found["columns_po"]))
            versions = f"{found['versions']}; "
    errors = {label: errors_of(model, each, full) for label, each in bases.items()}
    middle = {label: statistics.median(each) for label, each in seconds.items() if each}
    first = middle[next(iter(OURS))]
    rows: list[tuple[object, ...]] = []
    for label, error in errors.items():
        shown = [f"{error[r][0]:.1e}" for r in ORDERS] + [f"{error[ORDERS[-1]][1]:.1e}"]
        rows.append((label, f"{middle[label]:.3g} s", f"{middle[label] / first:.3g}", *shown))
    rows += [(label, why, *[""] * (len(ORDERS) + 2)) for label, why in missing.items()]
    heading = (
        *("model", f"time, order {ORDERS[-1]}", "times"),
        *(f"error, order {r}" for r in ORDERS),
        f"of the whole shape, order {ORDERS[-1]}",
    )
    used = "; ".join(f"{label}: {', '.join(map(str, each))}" for label, each in blocks.items())
    title = (
        f"## The same reduction by pyMOR\n\n{system.size:,} unknowns, 2 contact modes of 3 inputs, 6 outputs; "
        f"{versions}one thread each; {machine()}. Times: both contact modes, medians of {rounds} runs that took "
        "turns; fenics_rom's with its validation, pyMOR's with one observability Gramian for both contact modes. "
        f"Errors: largest |H - H_r| of the outputs at {len(FREQUENCIES)} frequencies up to 500 Hz, as a share of the "
        "largest |H|; the worse contact mode. Settings of pyMOR's Lyapunov solver: "
        f"{json.dumps(SETTINGS[BEST]['settings'])}. Columns of its Gramian factors: {used or 'none'}."
    )
    findings.table(title, heading, rows)
    findings.numbers["pyMOR, seconds"] = middle
    here = errors[next(iter(OURS))]
    for label in (each for each in SETTINGS if each in errors):
        ratios = [here[r][0] / errors[label][r][0] for r in ORDERS]
        apart = max(*ratios, *(1 / ratio for ratio in ratios))
        findings.at_most(f"errors beside those of {label}, the larger in the smaller", apart, PARITY)
        findings.at_least(f"time of {label}, in fenics_rom's", middle[label] / first, SLOWER[label], rate=True)


def variants(system: fr.System, model: Model, full: Responses, peer: Peer, findings: Findings) -> Found:
    """Section 2: what becomes of symmetry, stability and energy in the models of all of pyMOR's reductors."""
    rom = fr.reduce(system, order=FEW, weighting="outputs")
    one, other = model.inputs
    gain = max(float(np.linalg.norm(map, 2)) ** 2 for map in Projections(rom).between(one, other))
    findings.at_most("most energy that a switch of fenics_rom leaves of 1 J", gain, 1 + 1e-12)
    mine = {name: galerkin(model, rom.basis @ rom.contact_models[name].coordinates, name) for name in model.inputs}
    unstable = unstable_orders(stabilities(system, model))
    rows: list[tuple[object, ...]] = [described("fenics_rom", "", mine, model, full, unstable, gain)]
    findings.at_most("orders at which fenics_rom is unstable", 0 if unstable == "none" else 1, 0)
    try:
        found = peer({"what": "variants", "order": FEW, "orders": STABLE_AT, "settings": CONVERGED})
    except PeerError as error:
        found = {}
        rows.append(("pyMOR", str(error), *[""] * 5))
    for variant in VARIANTS if found else ():
        for projection in PROJECTIONS:
            keys = {name: f"{variant}_{projection}_B_{name}" for name in model.inputs}
            failed = found.get(f"failed_{keys[one]}")
            if failed is not None:
                rows.append((variant, projection, f"crashes: {failed}", *[""] * 4))
                continue
            made = {name: tuple(found[f"{symbol}_{key}"] for symbol in "MDKBC") for name, key in keys.items()}
            gain = float("nan")
            if f"V_{keys[one]}" in found:
                pairs = [(found[f"V_{key}"], found[f"W_{key}"]) for key in keys.values()]
                gain = switching_gain(model, *pairs)
            real = {
                r: max(float(found[f"stability_{variant}_{r}_B_{name}"]) for name in model.inputs) for r in STABLE_AT
            }
            rows.append(described(variant, projection, made, model, full, unstable_orders(real), gain))
    title = (
        f"## All of pyMOR's second-order reductors\n\nOrder {FEW}, Gramians with its best shifts, until they have "
        f"converged or for 500 steps ({json.dumps(CONVERGED)}); the worse contact mode. Symmetric: ‖A - Aᵀ‖ / ‖A‖ of "
        "M, D and K, the largest. Definite: the smallest eigenvalue of the symmetric parts as a share of the largest, "
        "the worst. Unstable: orders of "
        f"{', '.join(map(str, STABLE_AT))} at which an eigenvalue has a positive real part, and the largest, 1/s. "
        "Energy: the most that one switch to the other contact mode leaves of 1 J. pyMOR does not switch; its "
        "bases are carried over by the reductor's own projection, x → V₂ (W₂ᵀ M V₂)⁻¹ W₂ᵀ M x; ours by the simulator."
    )
    heading = (
        "reductor",
        "projection",
        "error",
        "symmetric to",
        "definite",
        "unstable at orders",
        "energy after a switch",
    )
    findings.table(title, heading, rows)
    return found


def described(
    variant: str,
    projection: str,
    made: dict[str, tuple[Array, ...]],
    model: Model,
    full: Responses,
    unstable: str,
    gain: float,
) -> tuple[object, ...]:
    """A row of the table of variants."""
    asymmetry, least, error = 0.0, np.inf, 0.0
    for name, (M, D, K, B, C) in made.items():
        for A in (M, D, K):
            asymmetry = max(asymmetry, float(np.linalg.norm(A - A.T) / np.linalg.norm(A)))
            λ = np.linalg.eigvalsh((A + A.T) / 2)
            least = min(least, float(λ[0] / np.abs(λ).max()))
        differences, sizes = [], []
        for ω, x in zip(FREQUENCIES, full[name], strict=True):
            H = model.C.T @ x
            differences.append(np.linalg.norm(H - C @ np.linalg.solve(K + 1j * ω * D - ω**2 * M, B)))
            sizes.append(np.linalg.norm(H))
        error = max(error, float(max(differences) / max(sizes)))
    energy = "" if np.isnan(gain) else f"{gain:.4g}"
    return variant, projection, f"{error:.1e}", f"{asymmetry:.0e}", f"{least:.1e}", unstable, energy


def stabilities(system: fr.System, model: Model) -> dict[int, float]:
    """The largest real part of an eigenvalue of our models of some orders, 1/s."""
    found: dict[int, float] = {}
    for order in STABLE_AT:
        for (name, _), basis in ours(system, order, "outputs").items():
            M, D, K, *_ = galerkin(model, basis, name)
            zero, unit = np.zeros_like(M), np.eye(len(M))
            A = np.block([[zero, unit], [-np.linalg.solve(M, K), -np.linalg.solve(M, D)]])
            found[order] = max(found.get(order, -np.inf), float(np.linalg.eigvals(A).real.max()))
    return found


def unstable_orders(real: dict[int, float]) -> str:
    """Those with eigenvalues of positive real part."""
    unstable = [order for order, largest in real.items() if largest > 0]
    return f"{', '.join(map(str, unstable))} ({max(real.values()):.1e})" if unstable else "none"


def galerkin(model: Model, V: Array, contact: str) -> tuple[Array, ...]:
    """M, D, K, B and C of the projection on V."""
    return (*(V.T @ (A @ V) for A in (model.M, model.D, model.K)), V.T @ model.inputs[contact], model.C.T @ V)


def switching_gain(model: Model, start: tuple[Array, Array], end: tuple[Array, Array]) -> float:
    """The most energy that x → V₂ (W₂ᵀ M V₂)⁻¹ W₂ᵀ M x leaves of 1 J, of displacements and of velocities in V₁."""
    V1, (V2, W2) = np.linalg.qr(start[0])[0], (np.linalg.qr(part)[0] for part in end)
    after = V2 @ np.linalg.solve(W2.T @ (model.M @ V2), W2.T @ (model.M @ V1))
    energies = ((after.T @ (A @ after), V1.T @ (A @ V1)) for A in (model.M, model.K))
    return max(float(eigh(kept, had, eigvals_only=True)[-1]) for kept, had in energies)


def stepping(system: fr.System, model: Model, found: Found, peer: Peer, findings: Findings) -> None:
    """Section 3: steps per second of one model of one contact mode, made by pyMOR's directions."""
    one = next(iter(model.inputs))
    single = replace(system, contacts={one: system.contacts[one]})
    key, given = f"SOBTfv_sr_B_{one}", peer.out / "reduced.npz"
    if f"V_{key}" in found:
        np.savez(given, **{symbol: found[f"{symbol}_{key}"] for symbol in "MDKBC"})
        rom = fr.reduce(single, method=given_directions({one: found[f"V_{key}"]}), order=FEW)
    else:
        rom = fr.reduce(single, order=FEW, weighting="outputs")
    forces = np.tile(INPUT, (STEPS, 1))
    rolled_out = fr.Simulator(rom, dt=STEP, ledger=False).rollout(forces)["patches"].reshape(STEPS, -1)
    rates, outputs, missing = {}, {}, ""
    turns: dict[str, list[float]] = {}
    for _ in range(ROUNDS):
        here = medians(loops(rom, forces), 1)
        try:
            task = {"what": "steps", "dt": STEP, "steps": STEPS, "input": INPUT}
            stepped = peer(task, given) if found else {}
        except PeerError as error:
            stepped, missing = {}, str(error)
        for label in ("as_it_comes", "fastest") if stepped else ():
            outputs[label] = stepped[f"outputs_{label}"]
            here[f"pyMOR, {label.replace('_', ' ')}"] = float(stepped[f"rate_{label}"])
        for label, rate in here.items():
            turns.setdefault(label, []).append(rate)
    rates = {label: statistics.median(each) for label, each in turns.items()}
    rows: list[tuple[object, ...]] = [(label, f"{rate:,.0f}") for label, rate in rates.items()]
    if missing or not found:
        rows.append(("pyMOR", missing or "see above"))
    title = (
        f"## Steps of the same reduced model\n\nOrder {FEW}, one contact mode of 3 inputs, {model.C.shape[1]} outputs "
        f"after every step, {STEPS:,} steps of {STEP:g} s under a constant force; one thread each; medians of {ROUNDS} "
        "runs that took turns. pyMOR: `ImplicitMidpointTimeStepper` on `to_lti()`; fastest: on dense matrices with an "
        "input that is given as constant."
    )
    findings.table(title, ("", "steps per second"), rows)
    findings.numbers["pyMOR, steps per second"] = rates
    for label, y in outputs.items():
        gap = np.abs(y[:, 1:].T - rolled_out).max() / np.abs(rolled_out).max()
        what = label.replace("_", " ")
        findings.at_most(f"difference of outputs to pyMOR's stepper ({what}) on its own directions", gap, 1e-8)
        findings.at_least(
            f"steps of fenics_rom in those of pyMOR, {what}", rates["step"] / rates[f"pyMOR, {what}"], 2, rate=True
        )


def given_directions(bases: dict[str, Array]) -> Callable[..., Iterator[tuple[str, Any]]]:
    """A reduction method: directions that are there already."""

    def directions_of_pymor(problem: Any) -> Iterator[tuple[str, Any]]:
        for name in problem.contacts:
            yield name, problem.directions(bases[name])

    return directions_of_pymor


def loops(rom: fr.Rom, forces: Array) -> dict[str, Callable[[], int]]:
    """Ours: single steps, a rollout, and many bodies at once; outputs after every step."""
    u = list(forces)

    def step(ledger: bool) -> Callable[[], int]:
        body = fr.Simulator(rom, dt=STEP, ledger=ledger)

        def run() -> int:
            for force in u:
                body.step(force)
                body.displacement("patches")
            return len(u)

        return run

    def rollout() -> int:
        fr.Simulator(rom, dt=STEP, ledger=False).rollout(forces)
        return len(forces)

    bodies = fr.Batch(rom, BODIES, STEP)
    same = np.tile(forces[0], (BODIES, 1))

    def batch() -> int:
        for _ in range(100):
            bodies.step(same)
            bodies.displacement("patches")
        return 100 * BODIES

    return {
        "step": step(False),
        "step, energy account kept": step(True),
        "rollout": rollout,
        f"Batch of {BODIES:,} bodies, of each": batch,
    }


def ours(system: fr.System, order: int, weighting: str) -> Bases:
    """Bases by contact mode and order."""
    rom = fr.reduce(system, order=order, weighting=weighting)
    return {(name, order): rom.basis @ mode.coordinates for name, mode in rom.contact_models.items()}


def errors_of(model: Model, bases: Bases, full: Responses) -> dict[int, tuple[float, float]]:
    """Transfer errors of the outputs and of the whole shape by order, the worse contact mode.

    Largest |H - H_r| over FREQUENCIES as a share of the largest |H|, in the Frobenius norm; of the shape in the mass
    norm. H from full solves, H_r from the Galerkin projection on the basis, whoever it comes from.
    """
    worst: dict[int, tuple[float, float]] = {}
    for (name, order), basis in bases.items():
        V = np.linalg.qr(basis)[0]
        m, d, k, b, _ = galerkin(model, V, name)
        pairs = []
        for ω, x in zip(FREQUENCIES, full[name], strict=True):
            error = x - V @ np.linalg.solve(k + 1j * ω * d - ω**2 * m, b)
            pairs.append([(float(np.linalg.norm(model.C.T @ y)), mass_norm(model.M, y)) for y in (error, x)])
        errors, sizes = np.max(pairs, axis=0)
        worst[order] = tuple(np.maximum(worst.get(order, (0.0, 0.0)), errors / sizes))
    return worst


def mass_norm(M: csr_matrix, x: Array) -> float:
    """√tr(xᴴ M x)."""
    return float(np.sqrt(np.vdot(x, M @ x).real))
