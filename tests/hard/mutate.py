"""How many small faults in the step, the switches and the energy account are found by tests.

    python tests/hard/mutate.py             # some minutes; not part of the test suite
    python tests/hard/mutate.py rollout.py    # only those of one file

Each fault is made in a copy of the package, one at a time; first the hard cases are run on it, and if they find
nothing, the tests of the runtime. Exits with 1 where less than 95 % are found.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[2]
COPIED = ("fenics_rom", "tests", "meshes", "demos/plate", "demos/hard_cases")
HARD = ["tests/hard/test_hard_cases.py", "-k", "every_claim and not material and not shape"]
RUNTIME = [
    f"tests/runtime/test_{name}.py"
    for name in (
        *(
            "midpoint",
            "rollout",
            "contact_rollout",
            "energy_laws",
            "simulator",
            "free_bodies",
            "viscoelasticity",
            "moving_frame",
        ),
        *("relaxing_large_deformation", "differentiation_deformation", "differentiation_frames", "followed_contact"),
        *("batch_deformation", "large_deformation_steps", "residual_compliance", "initial_state", "batch_contact"),
    )
] + ["tests/reduction/test_moving_frame_accuracy.py", "tests/fem/test_frame_contact.py"]
RUNTIME += [
    "tests/rom/test_material_points.py",
    "tests/rom/test_carried_strains.py",
    "tests/mechanics/test_hyperelastic.py",
    "tests/mechanics/test_complementarity.py",
]
RUNTIME += [f"tests/world/test_{name}.py" for name in ("rigid_motion", "joints", "surface_joints", "soft_motion")]
RUNTIME += ["tests/world/test_world_runs.py", "tests/world/test_rigid_collision.py"]
WANTED = 0.95
HUNG = 300  # s; a fault that makes a loop endless is found, too

MUTATIONS = [
    ("runtime/steppers/held_part.py", "self.h * place_ + 2 * velocity_", "self.h * place_ + velocity_"),
    ("runtime/steppers/parted_adjoint.py", "x_ + owed_ @ motion.x", "x_ + 0 * owed_ @ motion.x"),
    ("runtime/steppers/parted_adjoint.py", "touch.contact.through(*by_forces)", "touch.contact"),
    ("runtime/steppers/parted_adjoint.py", "-= η @ found.by_shape", "+= η @ found.by_shape"),
    ("runtime/steppers/parted_adjoint.py", "(1 - given) * by_goal", "given * by_goal"),
    ("runtime/steppers/frame_slopes.py", "sign / h * spin - spun", "sign / h * spin + spun"),
    ("runtime/steppers/frame_slopes.py", "np.cross(at.v, at.ω)", "np.cross(at.ω, at.v)"),
    ("runtime/steppers/parted_adjoint.py", "np.linalg.solve(whole, right)", "np.linalg.solve(whole.T, right)"),
    ("mechanics/surface_points.py", "np.linalg.solve(J, ", "np.linalg.solve(J.T + J, "),
    ("world/surfaces.py", "shares * (moments @", "(moments @"),
    (
        "mechanics/surface_points.py",
        "-weights[:, None, None] * crossed(arms)",
        "weights[:, None, None] * crossed(arms)",
    ),
    ("world/rigid.py", "τ_given = τ_given + couple", "pass"),
    ("world/step_pairs.py", "[joint.are_forces].sum(axis=0)", ".sum(axis=0)"),
    ("runtime/steppers/contact_midpoint.py", "self._r += self._Sᵀ.dot(impulses.ravel())", "pass"),
    ("mechanics/point_material.py", "side * 2 * defect / square", "side * defect / square"),
    ("rom/midpoint_map.py", "S = mode.damping_root, 2 / h + (h", "S = mode.damping_root, 1 / h + (h"),
    ("rom/midpoint_map.py", "(h / 2 + stiffening_time)", "(h + stiffening_time)"),
    ("rom/midpoint_map.py", "2 / h + (h / 2 + stiffening_time)", "2 / h - (h / 2 + stiffening_time)"),
    ("rom/midpoint_map.py", "a = 1 / (S + mode.damping)", "a = 1 / (S - mode.damping)"),
    ("rom/midpoint_map.py", "a = 1 / (S + mode.damping)", "a = 1 / S"),
    ("rom/midpoint_map.py", "return a, R * a", "return a, a"),
    ("rom/midpoint_map.py", "np.linalg.svd(R / np.sqrt(S))", "np.linalg.svd(R)"),
    ("rom/midpoint_map.py", "Uᵀ / np.sqrt(1 + σ[:, None] ** 2)", "Uᵀ / np.sqrt(1 + σ[:, None])"),
    ("rom/midpoint_map.py", "(σ / (1 + σ**2))", "(σ / (1 + σ))"),
    ("rom/midpoint_map.py", "[-np.diag(ω), 2 / h * np.eye(m)", "[np.diag(ω), 2 / h * np.eye(m)"),
    ("rom/midpoint_map.py", "2 / h * np.eye(m), mode.inputs]", "1 / h * np.eye(m), mode.inputs]"),
    ("rom/midpoint_map.py", "[h * ω[:, None] * v, 2 * v]", "[h / 2 * ω[:, None] * v, 2 * v]"),
    ("rom/midpoint_map.py", "[h * ω[:, None] * v, 2 * v]", "[h * ω[:, None] * v, v]"),
    ("rom/midpoint_map.py", "np.repeat([1.0, -1.0], m)", "np.repeat([1.0, 1.0], m)"),
    ("rom/midpoint_map.py", "np.sqrt(h) * heat", "h * heat"),
    ("rom/midpoint_map.py", "h * mode.inputs.T @ v", "h / 2 * mode.inputs.T @ v"),
    ("mechanics/viscoelasticity.py", "late = np.minimum(h / (2 * τ), 1.0)", "late = h / (2 * τ)"),
    ("mechanics/viscoelasticity.py", "whole = 1 + h / τ - late", "whole = 1 + h / τ"),
    ("mechanics/viscoelasticity.py", "moved = (h - late * τ) / whole", "moved = h / whole"),
    ("mechanics/viscoelasticity.py", "(1 - late) / whole", "1 / whole"),
    ("mechanics/viscoelasticity.py", "h * g / τ, of_change", "h * g, of_change"),
    ("mechanics/viscoelasticity.py", "if c.numerical.any()", "if not c.numerical.any()"),
    ("mechanics/viscoelasticity.py", "self.state = self.before\n", "pass\n"),
    ("mechanics/viscoelasticity.py", "self.set_time_step(h / parts)", "pass"),
    ("mechanics/viscoelasticity.py", "            self.before = before\n", "            pass\n"),
    ("mechanics/viscoelasticity.py", "self.state = self.state + gap", "pass"),
    ("mechanics/viscoelasticity.py", "float(g.sum() * gap[0].dot(gap[-1]))", "0.0"),
    ("runtime/steppers/elastic/sampled.py", "S += self._relaxation * of_rates[0] +", "S +="),
    ("runtime/steppers/elastic/sampled.py", "* of_rates[1] + self._history", "* of_rates[1]"),
    ("runtime/steppers/elastic/sampled.py", "(viscous * rates).sum(axis=0)", "(linear * rates).sum(axis=0)"),
    ("runtime/steppers/elastic/carried_strains.py", "viscous += float(v.dot(N.dot(v)))", "pass"),
    ("runtime/batch_deformation.py", "drawn += h * _dot(v, _times(N, v))", "pass"),
    ("mechanics/hyperelastic.py", "S[:3] -= λ * (rates[0] + rates[1] + rates[2])", "pass"),
    ("runtime/steppers/elastic/sampled.py", "heat + self.branches.step(np", "heat + 0 * self.branches.step(np"),
    ("runtime/steppers/held.py", "for part in (self.residual, self.elastic)", "for part in (self.residual,)"),
    ("runtime/steppers/elastic/carried_strains.py", "pulled = pulled + around.pulled(self.branches.pull[1])", "pass"),
    ("runtime/steppers/elastic/carried_strains.py", "pulled = around.pulled(was.strained[1])", "pass"),
    ("runtime/steppers/elastic/carried_strains.py", "force += now.around.pulled(self.branches.pull[1])", "pass"),
    ("runtime/steppers/deformation_maps.py", "strains.reshape(2, -1).copy() if strains.any() else E_OF_Q", "E_OF_Q"),
    (
        "runtime/steppers/elastic/carried_strains.py",
        "self._carried, self._next, self._q = self._carried_before, self._next_before, self._q_before",
        "self._next = None",
    ),
    (
        "runtime/steppers/elastic/carried_strains.py",
        "(middle)\n        self.matrix = around.stiffness(h / 2 + self._stiffening_time)",
        "(middle)\n        self.matrix = around.stiffness(h / 2)",
    ),
    ("runtime/steppers/elastic/carried_strains.py", "heat += self.branches.step", "self.branches.step"),
    ("runtime/steppers/elastic/carried_strains.py", "(float(v.dot(pulled)) + h / 2 * square)", "float(v.dot(pulled))"),
    ("runtime/steppers/elastic/carried_strains.py", "self.branches is not None or added > budget", "False"),
    ("runtime/steppers/elastic/carried_strains.py", "+ gap_s * (s + gap_s / 2)\n        if", "\n        if"),
    ("runtime/batch_deformation.py", "h * (_dot(v, pulled) + h / 2 * square)", "h * _dot(v, pulled)"),
    ("runtime/batch_contact.py", "transpose(2, 1, 0) @ self._axes", "transpose(2, 1, 0)"),
    ("runtime/batch_contact.py", ".offsets_at(time) @ self._axes.T", ".offsets_at(time)"),
    ("runtime/batch_residual.py", ".reshape(3, -1).T @ self._axes", ".reshape(3, -1).T"),
    ("runtime/batch_contact_mode.py", 'work += np.einsum("apb,apb->b", forces, yields)', "pass"),
    ("runtime/batch_contact_mode.py", "4 / h**2 * a", "a / 4"),
    ("runtime/joint_bodies.py", "if contacts is None or not any(couplings) else w.copy()", "if True else w"),
    ("mechanics/batch_contact_solver.py", "response.push[added] *= share[:, None]", "pass"),
    ("mechanics/batch_contact_solver.py", "share * (given[added] + share", "(given[added] + share"),
    ("mechanics/batch_contact_solver.py", "again = ~settled", "again = ~settled & False"),
    ("mechanics/complementarity/splitting.py", "> TOLERANCE * part.scale", "> 1e4 * TOLERANCE * part.scale"),
    (
        "mechanics/complementarity/splitting.py",
        "own = own[~(taken(u, own) != 0).any",
        "own = own[(taken(u, own) != 0).all",
    ),
    ("mechanics/complementarity/splitting.py", "part.scale), forces[places]", "1e4 * part.scale), forces[places]"),
    ("mechanics/batch_contact_solver.py", "(self.target + along(u", "(self.target - along(u"),
    ("mechanics/batch_contact_solver.py", "alone |= pairs.others_due(chosen, u) & settled", "pass"),
    ("mechanics/batch_contact_solver.py", "alone[pending] |= pairs", "_ = pairs"),
    ("mechanics/complementarity/splitting.py", "length += np.multiply(second, second, out=ratio)", "pass"),
    ("mechanics/complementarity/batched_newton.py", " - 1, STIFFEST)", " - 1, np.inf)"),
    ("mechanics/complementarity/batched_newton.py", "unsettled[goes_on] = True", "pass"),
    ("runtime/batch_deformation.py", "over = (added > budget)", "over = (added > 2 * budget + 1)"),
    ("runtime/batch_deformation.py", "then.strains[:, bodies] = went + share * gap", "pass"),
    ("runtime/batch_deformation.py", "slope**2 + 2 * square * budget", "slope**2 + square * budget"),
    ("runtime/batch_deformation.py", "(_dot(force + linear, q) + upper[:, 0])", "_dot(force + linear, q)"),
    ("mechanics/hyperelastic.py", "S[:3] += volumetric - shear * change", "S[:3] -= shear * change"),
    ("mechanics/hyperelastic.py", "X[::4] -= trace", "pass"),
    ("mechanics/hyperelastic.py", "np.log1p(change * (1 + J)) / 2", "np.log1p(change)"),
    ("mechanics/hyperelastic.py", "W += volumetric * lnJ / 2", "W += volumetric * lnJ"),
    ("rom/material_points.py", "F[::4] += 1.0", "pass"),
    ("rom/material_points.py", "twice += H.swapaxes(0, 1)", "pass"),
    ("runtime/steppers/training_watch.py", "np.sqrt(1 + 2 * strains)) * self._reach", "1.0) * self._reach"),
    ("runtime/steppers/training_watch.py", "self._reach = 1 / np.sqrt(", "self._reach = 1.01 / np.sqrt("),
    ("rom/material_points.py", "others *= moves.take(_I, 1)", "pass"),
    ("rom/carried_strains.py", "np.subtract(products[0], products[1], products[1])", "pass"),
    ("rom/carried_strains.py", "pulled -= shape.K.dot(change)", "pass"),
    ("rom/carried_strains.py", "+ self.upper.item(0)", ""),
    ("rom/deformation.py", "self.shapes[3:] - self.shapes[:-3]", "self.shapes[3:]"),
    (
        "runtime/steppers/contact_midpoint.py",
        "right -= self._ω * self.branches.pull[0]",
        "right -= self.branches.pull[0]",
    ),
    ("runtime/steppers/contact_midpoint.py", "self.branches.step((self._ω * v)[None])", "self.branches.step(v[None])"),
    ("mechanics/followed_contact.py", "_HALF * relative", "0.4 * relative"),
    ("mechanics/followed_contact.py", "else _HALF * approach", "else approach"),
    ("mechanics/complementarity/cones.py", "np.maximum(pressure, zeros) * normals", "pressure * normals"),
    ("runtime/steppers/followed_points.py", "0.5 if law.friction else 0.0", "0.3 if law.friction else 0.0"),
    ("runtime/steppers/followed_points.py", "margin += self._share * approach", "pass"),
    ("runtime/steppers/followed_points.py", "if not self._way.dot(self._way) <= self._farthest:", "if False:"),
    ("runtime/steppers/steady_pairs.py", "self._turn @ kept.inverse @ self._turn.T", "kept.inverse"),
    (
        "mechanics/contact_solver.py",
        "frames is search.frames and (search.planes is None or planes is not None)",
        "frames is search.frames",
    ),
    ("mechanics/active_environment.py", "is_constant and u.base is None and not", "is_constant and not"),
    ("runtime/steppers/steady_pairs.py", "np.eye(len(J)) - J * self._compliance + J @ self._W", "np.eye(len(J))"),
    ("runtime/steppers/steady_pairs.py", "q = q + (off * n).ravel()", "pass"),
    ("runtime/steppers/steady_pairs.py", "rows[[0, 1, 2, 5]]", "rows[[0, 1, 2, 4]]"),
    ("mechanics/complementarity/solution.py", "- 6 * lacked[3] - lacked[7]", "- 5 * lacked[3] - lacked[7]"),
    ("runtime/steppers/steady_pairs.py", "rest, share * approach - rest", "rest, 0.0 * rest"),
    ("runtime/steppers/steady_pairs.py", "argmin()) < 0.0:", "argmin()) < -1e9:"),
    ("runtime/steppers/steady_pairs.py", "missed[self._idle] = away < 0.0", "missed[self._idle] = away < 1e9"),
    ("runtime/steppers/steady_pairs.py", "if by_friction > 0 and", "if by_friction > 1e9 and"),
    ("runtime/steppers/steady_pairs.py", "- Jq\n        return now", "+ Jq\n        return now"),
    ("runtime/steppers/steady_pairs.py", "power = float(pressure.dot(target))", "pass"),
    (
        "runtime/steppers/steady_pairs.py",
        "if corrections or not is_last:\n            self._acts",
        "if not is_last:\n            self._acts",
    ),
    ("runtime/steppers/followed_points.py", "pairs += self._by_beyond.dot(self._beyond)", "pass"),
    ("runtime/steppers/following_midpoint.py", "self.h * (by_normals - power)", "0.0"),
    ("runtime/steppers/clearance.py", "self._room -= self._h", "self._room -= 0 * self._h"),
    ("mechanics/complementarity/following.py", "(z,) = framed.frames.turned(z.T)", "z = z.copy()"),
    ("mechanics/followed_contact.py", "level) > chosen", "level) > 1"),
    ("mechanics/contact_pairs.py", "if gap < 0.0:", "if gap < -1.0:"),
    ("mechanics/followed_contact.py", "if by_friction > 0 and", "if by_friction > 1e9 and"),
    ("mechanics/followed_contact.py", " + λ.dot(target))", ")"),
    ("runtime/steppers/stepper.py", "b[:] = b_start @ potential.T", "b[:] = 0"),
    ("runtime/steppers/residual_motion.py", "max(h / 2, h - β)", "h / 2"),
    ("runtime/steppers/residual_motion.py", "inertia + β + elastic + stiffening_time, β", "inertia + elastic, β"),
    ("runtime/steppers/residual_motion.py", "β + elastic - h / 2)", "β)"),
    ("runtime/steppers/residual_motion.py", "(inertia * ẏ - y + Rf) / a", "(inertia * ẏ + Rf) / a"),
    ("runtime/steppers/residual_motion.py", "2 * ẏ_mid - ẏ, ġ_mid", "ẏ_mid, ġ_mid"),
    ("runtime/steppers/residual_motion.py", "beyond: Array = self._y - ", "beyond: Array = self._y + "),
    ("runtime/steppers/residual_motion.py", "+ y - here.basis_points.dot(e)", "+ y"),
    ("runtime/steppers/residual_motion.py", "if stored > most else 1.0", "if stored > 2 * most else 1.0"),
    ("runtime/batch_residual.py", "over = held > most", "over = held > 2 * most"),
    ("rom/residual_part.py", "np.hstack([H - HY @ Y.T,", "np.hstack([H,"),
    ("reduction/residual_compliance.py", "solved - Q @ C[:, columns]", "solved + Q @ C[:, columns]"),
    ("reduction/residual_compliance.py", "np.sqrt(np.maximum(τ2, 0.0))[::-1]", "np.sqrt(np.maximum(τ2, 0.0))"),
    ("rom/residual_part.py", "τ2_within, τ2_beyond = 1 / κ", "τ2_within, τ2_beyond = 0 / κ"),
    ("reduction/residual_compliance.py", "LEAST = 1e-12", "LEAST = 1e-16"),
    ("reduction/methods/modal.py", "B if yields else system.forces(name)", "system.forces(name)"),
    ("runtime/initial_state.py", "np.repeat([1.0, 1.0, 0.0, 0.0]", "np.repeat([0.0, 0.0, 0.0, 0.0]"),
    ("runtime/steppers/residual_motion.py", "self._rows[4:] -= self._branches.pull", "pass"),
    ("runtime/steppers/residual_motion.py", "free -= (self._branches.pull[1]", "free += (self._branches.pull[1]"),
    (
        "runtime/steppers/midpoint.py",
        "self._ledger.book(supplied=float(supplied.sum()), dissipated=float(dissipated.sum()))",
        "self._ledger.book(supplied=float(supplied.sum()))",
    ),
    ("runtime/steppers/midpoint.py", "self._booked = self._page\n", "pass\n"),
    ("runtime/steppers/midpoint.py", "steps = self.h / 2 * (r[1:] + r[:-1])", "steps = self.h * r[1:]"),
    ("runtime/steppers/midpoint.py", "self._states[0][:] = self.state", "pass"),
    ("runtime/steppers/midpoint.py", "self._page = self._booked = 0", "self._page = 0"),
    ("runtime/steppers/midpoint.py", "rows[:, self._m :], self._pages", "rows[:, : -self._m], self._pages"),
    ("runtime/steppers/midpoint.py", "kept, forced = np.stack([-ω,", "kept, forced = np.stack([ω,"),
    ("runtime/steppers/midpoint.py", "np.full(model.order, 2 / h)", "np.full(model.order, 1 / h)"),
    ("runtime/steppers/midpoint.py", "else 2 * a * kept", "else a * kept"),
    ("runtime/steppers/midpoint.py", "else 2 * a[:, None] * forced", "else a[:, None] * forced"),
    ("runtime/steppers/midpoint.py", "self._travel = h / 2 * ω", "self._travel = h * ω"),
    ("runtime/steppers/midpoint.py", "np.add(next_e, e, next_e)", "pass"),
    ("runtime/steppers/midpoint.py", "np.subtract(v, r, next_r)", "np.add(v, r, next_r)"),
    ("runtime/steppers/midpoint.py", "self.h / 2 * supplied, self.h / 4", "self.h * supplied, self.h / 4"),
    ("runtime/steppers/midpoint.py", "self.h / 2 * supplied, self.h / 4", "self.h / 2 * supplied, self.h / 2"),
    (
        "rom/contact_model.py",
        "np.sqrt(κ)[:, None] * model.coordinates / model.safe_frequencies",
        "model.coordinates / model.safe_frequencies",
    ),
    (
        "rom/switch_maps.py",
        "strained_coordinates(κ, end).T @ strained_coordinates(κ, start)",
        "strained_coordinates(κ, start).T @ strained_coordinates(κ, end)",
    ),
    ("rom/switch_maps.py", "(U * np.minimum(s, 1.0)) @ Vᵀ", "U @ Vᵀ"),
    ("rom/switch_maps.py", "(U * np.minimum(s, 1.0)) @ Vᵀ", "(U * s * (1 + 1e-13)) @ Vᵀ"),
    ("rom/switch_maps.py", "diagonally(np.eye(rigid), kinetic)", "diagonally(np.zeros((rigid, rigid)), kinetic)"),
    ("rom/switch_maps.py", "_clip_cosines(end.coordinates[:, rigid:].T", "_clip_cosines(-end.coordinates[:, rigid:].T"),
    ("runtime/switching.py", "if (start, end) not in self._maps", "if not self._maps"),
    ("runtime/steppers/stepper.py", "left.energy - self.kernel.energy", "left.energy - 2 * self.kernel.energy"),
    (
        "runtime/steppers/stepper.py",
        "np.dot(potential, before[:m], out=after[:n])",
        "np.dot(kinetic, before[:m], out=after[:n])",
    ),
    (
        "mechanics/energy_ledger.py",
        "(supplied, dissipated, lost_in_switching, numerical))",
        "(2 * supplied, dissipated, lost_in_switching, numerical))",
    ),
    (
        "mechanics/energy_ledger.py",
        "(supplied, dissipated, lost_in_switching, numerical))",
        "(supplied, 0.0, lost_in_switching, numerical))",
    ),
    (
        "mechanics/energy_ledger.py",
        "dissipated, lost_in_switching, numerical))",
        "dissipated, -lost_in_switching, numerical))",
    ),
    ("mechanics/energy_ledger.py", "amount, -rounded))", "amount, rounded))"),
    ("mechanics/energy_ledger.py", "self.flush()\n        return tuple", "return tuple"),
    ("mechanics/energy_ledger.py", "self.flush()  # what is not yet booked belongs to the old ones", "pass"),
    ("runtime/rollout.py", "work[2 * m :] = account[m:]", "work[2 * m :] = 2 * account[m:]"),
    ("runtime/rollout.py", "work, heat.T @ heat)", "work, 2 * heat.T @ heat)"),
    (
        "runtime/rollout.py",
        "lift[: len(first.state), :size] = first.state",
        "lift[: len(first.state), :size] = 0.999 * first.state",
    ),
    ("runtime/rollout.py", "lift[len(first.state) :, size:] = np.eye(added)", "pass"),
    ("runtime/rollout.py", "np.pad(of_first, (0, added)) + lift.T", "lift.T"),
    (
        "runtime/rollout.py",
        "sum_works(first.dissipated, second.dissipated)",
        "sum_works(first.dissipated, first.dissipated)",
    ),
    ("runtime/rollout.py", "if times % 2 else whole", "if False else whole"),
    ("runtime/rollout.py", "np.add(after, push, after)", "pass"),
    (
        "runtime/rollout.py",
        "supplied += float(np.vdot(z @ block.supplied, z))",
        "supplied = float(np.vdot(z @ block.supplied, z))",
    ),
    ("runtime/rollout.py", "state[:] = states[-1]", "state[:] = states[-2]"),
    ("runtime/rollout.py", "| (sizes[1:] != sizes[:-1])", ""),
    ("runtime/rollout.py", "names[1:] != names[:-1]) | (", "names[1:] != names[1:]) | ("),
    ("runtime/kept_contact.py", "((normal < level) == chosen).all(axis=1)", "np.full(L, True)"),
    ("runtime/kept_contact.py", "(normal < level) == chosen", "(normal < level) <= chosen"),
    ("runtime/kept_contact.py", "look.is_due & (look.error <= CONV", "look.is_due | (look.error <= CONV"),
    ("runtime/kept_contact.py", "leading(look.is_due & (look.error <= STAGNATION_RESIDUAL)", "leading(look.is_due"),
    ("runtime/kept_contact.py", "cone, length = self._meeting.law.friction", "cone, length = np.inf"),
    ("runtime/kept_contact.py", "max(axis=1) <= SAME_NORMALS", "max(axis=1) <= 1.0"),
    ("runtime/kept_contact.py", "is_due &= ((moved < level) <= chosen)", "0 * ((moved < level) <= chosen)"),
    ("runtime/kept_contact.py", "part[0] = 0.0 if self._rule.is_elastic else 0.5", "pass"),
    ("runtime/kept_contact.py", "states[:-1:2] @ power + first", "states[:-1:2] @ power + second"),
    ("runtime/kept_contact.py", "first @ power + second", "second @ power + first"),
    ("runtime/kept_contact.py", "dissipated, -h * normal, h * (normal", "dissipated, 0.0, h * (normal"),
    ("runtime/kept_contact.py", "dissipated += self._residual.heat", "dissipated += 0 * self._residual.heat"),
    ("runtime/contact_blocks.py", "kernel.state[:rigid] = 0.0", "pass"),
    ("runtime/contact_blocks.py", "return leading(points.nearest", "return len(steps.inputs) or (points.nearest"),
    ("runtime/stepped_rollout.py", "blocks.take(u[taken:-1])", "blocks.take(u[taken:])"),
    ("runtime/contact_blocks.py", "g.any(axis=1) | ġ.any(axis=1)", "g.any(axis=1) & False"),
    ("runtime/stepped_rollout.py", "every - 1 - taken % every", "every - 1"),
    ("runtime/steppers/free_balance.py", "x_ / 2 - t[0]", "x_ / 2 + t[0]"),
    ("runtime/steppers/free_balance.py", "1.0, 2 / h * (a - A)", "1.0, 1 / h * (a - A)"),
    ("runtime/steppers/free_frame.py", "τ = added(τ, 1.0, prescribed.torque)", "τ = added(τ, -1.0, prescribed.torque)"),
    ("runtime/steppers/free_frame.py", "supplied += dot(prescribed.turning, (a, b, c))", "supplied += 0.0"),
    ("runtime/steppers/free_balance.py", "(2 * u - x, 2 * v - y, 2 * w - z)", "(x, y, z)"),
    ("runtime/steppers/free_frame.py", "r̂ + r̂ - self._r", "r̂"),
    ("runtime/steppers/frame_kernel.py", "h / 2 * self._second,", "0 * self._second,"),
    (
        "runtime/steppers/frame_kernel.py",
        "np.concatenate([self._second, frame",
        "np.concatenate([0 * self._second, frame",
    ),
    ("runtime/steppers/frame_kernel.py", "frame.inertia2 - frame.stiffening", "frame.inertia2 + frame.stiffening"),
    ("runtime/steppers/frame_kernel.py", "np.add(self._turned, self._coupled, self._turned)", "pass"),
    ("mechanics/frame_motion.py", "added(b, -0.5, cross(t, b))", "added(b, 0.5, cross(t, b))"),
    ("mechanics/frame_geometry.py", "self.start.dot(cross_matrix(self.turn)) / 2", "0.0"),
    (
        "mechanics/frame_geometry.py",
        "return (start.dot(turn.start.T) + end.dot(turn.end.T)) / 2",
        "return start.dot(turn.start.T)",
    ),
    (
        "runtime/steppers/carried_balance.py",
        "cross(ω, v_end), 1.0, cross(ω_end, v)",
        "cross(ω, v_end), -1.0, cross(ω_end, v)",
    ),
    ("runtime/steppers/carried_frame.py", "supplied -= h * (dot", "supplied += h * (dot"),
    (
        "runtime/steppers/carried_frame.py",
        "added(cross(ω̂, L̂), 1.0, cross(v̂, P̂))",
        "added(cross(ω̂, L̂), -1.0, cross(v̂, P̂))",
    ),
    ("mechanics/frame_geometry.py", "inside.dot(turn.middle.T)", "inside.dot(turn.start.T)"),
    ("fem/frame_balance.py", "else ρ - push.modal", "else ρ"),
    ("fem/frame_balance.py", "power -= float(push.force", "power += float(push.force"),
    ("fem/frame_balance.py", "inertial - force @ turn.middle", "inertial + force @ turn.middle"),
    ("fem/frame_step.py", "now.ω, inside) + along", "now.ω, inside)"),
    ("fem/frame_balance.py", "cross(ω_end, My_end) - np", "cross(ω_end, My_end) + np"),
    ("fem/nodal_frame.py", "inertia -= np.array", "inertia += np.array"),
    ("mechanics/base_fit.py", "added(v̂, 0.5, cross", "added(v̂, -0.5, cross"),
    ("runtime/steppers/moving_frame.py", "self._carried_along = holding(", "self._carried_along = None and holding("),
    (
        "runtime/steppers/inertia.py",
        "(2 / (a + np.sqrt(a**2 + 4 * c))) ** 2",
        "1e3 * (2 / (a + np.sqrt(a**2 + 4 * c))) ** 2",
    ),
    ("world/driven.py", "1.0, cross(ω, arm)", "-1.0, cross(ω, arm)"),
    ("runtime/steppers/pushed_step.py", "(self._places - middle)[points", "self._places[points"),
    ("runtime/steppers/pushed_step.py", "slopes[6:, SPIN] -= points", "slopes[6:, SPIN] += points"),
    ("runtime/steppers/pushed_step.py", "np.where(follows, 0.0, by_x) - along", "np.where(follows, 0.0, by_x - along)"),
    ("runtime/steppers/pushed_step.py", "now.push.torque).dot(R)", "now.push.torque).dot(middle)"),
    ("world/contact_step.py", "proximal *= STEADIER", "proximal *= 1.0"),
    ("world/rigid.py", "per_push[3:, :3] = levered", "per_push[3:, :3] = -levered"),
    ("world/rigid.py", "float((torque - self._torque).dot(turning))", "float(torque.dot(turning))"),
    ("world/rigid.py", "h * (ω * self.size + h * (g + speeds_up / 4))", "0.0"),
    ("world/driven.py", "R.dot(cayley(turn / 2))", "R"),
    ("world/driven.py", "(R + self._R_end) / 2, R.dot(turn / h)", "R, R.dot(turn / h)"),
    ("world/recorder.py", "account.supplied - account.obstacles", "account.supplied"),
    ("world/recorder.py", "*pose.velocity, *pose.angular_velocity", "*pose.angular_velocity, *pose.velocity"),
    ("world/recorder.py", "vertices @ rotation_matrix(pose.rotation).T", "vertices @ rotation_matrix(pose.rotation)"),
    ("world/collision/flat_ground.py", "gaps[near, None] / 2 * normal", "0 * normal"),
    ("world/collision/round_shapes.py", "(shape.radius + gaps / 2)", "(shape.radius + 0 * gaps)"),
]


def main() -> None:
    """Makes each fault, runs the tests, and tables what found it."""
    chosen = [m for m in MUTATIONS if len(sys.argv) < 2 or m[0].endswith(sys.argv[1])]
    found, by_hard_cases = 0, 0
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        for part in COPIED:
            shutil.copytree(ROOT / part, copy / part, ignore=shutil.ignore_patterns("out", "__pycache__", "*.h5"))
        shutil.copy(ROOT / "pyproject.toml", copy)
        if not passes(copy, HARD) or not passes(copy, RUNTIME):
            sys.exit("the tests fail without any fault")
        for file, right, wrong in chosen:
            path = copy / "fenics_rom" / file
            text = path.read_text()
            if text.count(right) != 1:
                sys.exit(f"{file}: {right!r} is there {text.count(right)} times; use once")
            path.write_text(text.replace(right, wrong))
            hard = not passes(copy, HARD)
            caught = hard or not passes(copy, RUNTIME)
            path.write_text(text)
            found, by_hard_cases = found + caught, by_hard_cases + hard
            verdict = "hard cases" if hard else "runtime tests" if caught else "NOT FOUND"
            print(f"{verdict:13}  {file}: {right.strip()!r} -> {wrong.strip()!r}", flush=True)
    print(f"{found} of {len(chosen)} found, {by_hard_cases} by the hard cases alone")
    sys.exit(0 if found >= WANTED * len(chosen) else 1)


def passes(copy: Path, tests: list[str]) -> bool:
    """Whether tests pass in a copy of the project."""
    command = [sys.executable, "-B", "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests]
    environment = {**os.environ, "PYTHONPATH": str(copy)}
    try:
        return subprocess.run(command, cwd=copy, env=environment, capture_output=True, timeout=HUNG).returncode == 0
    except subprocess.TimeoutExpired:
        return False


if __name__ == "__main__":
    main()
