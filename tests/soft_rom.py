"""A reduced soft box that keeps all its points, on its lowest eigenvectors: what the steps are tested with."""

from dataclasses import replace

import numpy as np
import scipy.linalg
from bodies import box_arrays
from soft_box import scalar_mass, soft_box

import fenics_rom as fr
from fenics_rom.compilation import compiled
from fenics_rom.errors import StepError
from fenics_rom.reduction.moving_frame import inertia_constants
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.deformation import ReducedDeformation, ReducedTendon, monomials
from fenics_rom.rom.residual_compliance import ResidualCompliance
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.steppers.held import HeldBody
from fenics_rom.scene.file import parse_scene

CONTACT = """
[effects.contact.obstacles.floor]
shape = "half-space"
point = [0.0, 0.0, -0.008]
normal = [0.0, 0.0, 1.0]
[effects.friction]
coefficient = 0.4
"""


Array = np.ndarray

SOFT_BOX = (0.3, 0.02, 0.02), (6, 1, 1), "dt = 5e-3\nduration = 0.1"


def soft_rom(
    law: str = "st_venant_kirchhoff",
    *,
    order: int = 12,
    alpha: float = 1.0,
    beta: float = 2e-3,
    inertia: bool = True,
    contact: bool = False,
    touched_from: float = 0.3,
    bent: Array | None = None,
) -> Rom:
    """A slender box, 0.3 m long, with contact modes "tip" and "middle", pressure "air" and tendon "cable".

    Its basis has the lowest eigenvectors or, of an order, `bent` shapes (n, s) and the lowest ones beside. With contact
    the floor touches nodes from some x on, m.
    """
    system = soft_box(*SOFT_BOX, law=law, alpha=alpha, beta=beta)
    body, nodes = system.deformation, system.body.nodes
    K, M = system.stiffness.toarray(), system.mass.toarray()
    γ, W = scipy.linalg.eigh(K, M, subset_by_index=[0, order - 1])
    if bent is not None:
        W = np.hstack([bent, W[:, : order - bent.shape[1]]])
        γ, U = scipy.linalg.eigh(W.T @ K @ W, W.T @ M @ W)
        W = W @ U
    touched = (
        np.flatnonzero((nodes[:, 0] > touched_from - 1e-6) & np.isclose(nodes[:, 2], 0.0))
        if contact
        else np.empty(0, int)
    )
    modes = {
        name: ContactModel(
            eigenvalues=γ,
            damping=alpha + beta * γ,
            inputs=W.T @ np.hstack([B, *system.actuators.values()]),
            coordinates=np.eye(order),
            directions=np.eye(order),
            hankel_singular_values=np.empty(0),
            contact_points=touched,
        )
        for name, B in system.contacts.items()
    }
    effects = ["[effects]", f"damping = {{ alpha = {alpha}, beta = {beta} }}"]
    effects = [*effects, "inertia = {}"] if inertia else effects[:1]
    effects.append(f'large_deformation = {{ material = "{law}" }}')
    text = system.scene.text
    start, end = text.index("[effects]"), text.index("[effects.pressure.air]")
    text = text[:start] + "\n".join(effects) + (CONTACT if contact else "\n") + text[end:]
    if contact and inertia:
        text = text.replace("[effects.contact.obs", "[effects.contact]\nrestitution = 0.5\n[effects.contact.obs")
    points, shapes = body.tendons["cable"]
    yields = yielding(system, W, γ, touched, beta) if contact else None
    external_damping = W.T @ (body.external_damping @ W)
    return Rom(
        name="soft box",
        switching="energy",
        contact_models=modes,
        actuators={"air": 1, "cable": 1},
        basis=W,
        stiffness=γ,
        outputs={"tip": system.outputs["tip"].T @ W},
        free=body.free,
        nodes=nodes,
        triangles=system.body.triangles,
        node_mass=system.body.node_mass,
        environment=parse_scene(text).environment,
        scene_text=text,
        residual_compliance=yields,
        deformation=ReducedDeformation(
            law=law,
            gradients=body.gradients(W),
            weights=body.weights,
            first_lame=body.first_lame,
            shear=body.shear,
            viscosity=body.viscosity,
            external_damping=(external_damping + external_damping.T) / 2,
            springs=np.zeros((order, order)),
            training_radius=0.05,
            points_of=len(body.weights),
            cubature_error=0.0,
            pressures={"air": pressed(body, W)},
            tendons={"cable": ReducedTendon(points, shapes.T @ W)},
        ),
    )


def in_frame(rom: Rom) -> Rom:
    """A soft box of large deformation in the frame of a base that carries it."""
    cells = box_arrays(*SOFT_BOX[:2])
    M = np.kron(scalar_mass(*cells, 1100.0).toarray(), np.eye(3))
    Q = np.zeros((rom.nodes.size, rom.basis.shape[1]))
    Q[rom.free] = rom.basis
    frame = inertia_constants(rom.nodes, M, Q, carried=True, origin=np.zeros(3))
    p = {name: model.inputs.shape[1] for name, model in rom.contact_models.items()}
    frame = replace(frame, wrenches={name: np.zeros((6, width)) for name, width in p.items()})
    return replace(rom, moving_frame=frame, environment=replace(rom.environment, frame="moving"))


def yielding(system, W, γ, touched, beta) -> ResidualCompliance:
    """What the basis lacks at nodes that are touched, by dense solves."""
    Sᵀ = np.zeros((system.size, 3 * len(touched)))
    Sᵀ[np.searchsorted(system.deformation.free, (3 * touched[:, None] + np.arange(3)).ravel()), range(len(Sᵀ.T))] = 1.0
    X = np.linalg.solve(system.stiffness.toarray(), Sᵀ) - W / γ @ (W.T @ Sᵀ)
    R = Sᵀ.T @ X
    τ2, V = scipy.linalg.eigh(X.T @ (system.mass @ X), (R + R.T) / 2)
    return ResidualCompliance(R @ V, np.sqrt(τ2), 1e-6 * np.linalg.eigvalsh(R)[-1], beta)


def linear(rom: Rom) -> Rom:
    """The same without large deformation."""
    return replace(rom, deformation=None)


def pressed(body, W) -> np.ndarray:
    """The polynomial of a pressure's force, fitted to more shapes than it has coefficients."""
    m = W.shape[1]
    rng = np.random.default_rng(0)
    shapes = 0.05 * rng.standard_normal((2 * (1 + m + m * (m + 1) // 2), m))
    forces = np.array([(W.T @ body.follower(W @ q)["air"])[:, 0] for q in shapes])
    return np.linalg.lstsq(np.array([monomials(q) for q in shapes]), forces, rcond=None)[0].T


def swing(rom: Rom, h: float, stepper: str | None, *, force: float = 0.2, duration: float = 0.32) -> fr.Simulator:
    """Pulled at its tip and let go."""
    simulator = fr.Simulator(rom, h, stepper=stepper)
    for step in range(round(duration / h)):
        simulator.step([0.0, 0.0, force * (step * h < duration / 2), 0.0, 0.0])
    return simulator


def refuse_few_parts(monkeypatch, fewest: int, longer_than: float = 0.0) -> list[int]:
    """Has Newton's steps that are longer fail in fewer parts; those that did."""
    in_parts, refused = HeldBody._in_parts, []

    def failing(kernel, u, obstacles, parts):
        if kernel.elastic.is_exact or parts >= fewest or kernel.h <= longer_than:
            return in_parts(kernel, u, obstacles, parts)
        refused.append(parts)
        raise StepError("in too few parts")

    monkeypatch.setattr(HeldBody, "_in_parts", failing)
    if compiled() and fewest > 1:  # loops take steps whole
        from fenics_rom.runtime.steppers.compiled_held import CompiledHeld

        take = CompiledHeld.take

        def taken(loops, *given):
            return None if loops.body.sampled is not None and loops.body.law.h > longer_than else take(loops, *given)

        monkeypatch.setattr(CompiledHeld, "take", taken)
    return refused
