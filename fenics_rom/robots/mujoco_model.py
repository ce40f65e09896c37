"""A robot as MuJoCo has compiled it: links by what moves them, their joints, and what acts along these."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError
from fenics_rom.mechanics.frame_motion import quaternion_of, rotation_matrix
from fenics_rom.robots.geometry import StaticShape, link_shape, static_shapes, visuals_of
from fenics_rom.robots.records import Frame, Robot
from fenics_rom.robots.urdf import Urdf
from fenics_rom.robots.xml_lines import Element
from fenics_rom.world.drives import Drive, Motor
from fenics_rom.world.joints import AnyJoint, ball, hinge, slider, weld
from fenics_rom.world.make_bodies import FIXED
from fenics_rom.world.records import RigidBody

FREE, BALL, SLIDE, HINGE = range(4)  # kinds of joints
CONNECT, WELD, OF_JOINTS = range(3)  # kinds of equations
NONE, FIXED_GAIN, AFFINE = 0, 0, 1  # kinds of gains and biases of actuators
OF_JOINT = 0  # what an actuator acts on


class MujocoModel:
    """A robot.

    Args:
        mujoco: the module.
        path: of its file.
        root: of that.
        urdf: what it is made of, if it is one.
        base: position and quaternion of its base.

    Raises:
        SceneError: MuJoCo refuses it, or it has what is not known here.
    """

    def __init__(self, mujoco: Any, path: Path, root: Element, urdf: Urdf | None, base: tuple[Array, Array]):
        self._mj, self._path, self._root, self._urdf = mujoco, path, root, urdf
        self.warnings = [f"left out: {each}" for each in urdf.left_out] if urdf is not None else []
        try:
            spec = mujoco.MjSpec.from_string(urdf.text()) if urdf is not None else mujoco.MjSpec.from_file(str(path))
            self._model = model = spec.compile()
        except ValueError as error:
            said = " ".join(str(error).split())
            raise SceneError(f"{path}{self._where(str(error))}: MuJoCo refuses it: {said}") from error
        self._data = mujoco.MjData(model)
        self._base = base[0], rotation_matrix(base[1])
        self._names = [model.body(b).name or f"body{b}" for b in range(model.nbody)]
        self.joint_names = [model.joint(j).name or f"joint{j}" for j in range(model.njnt)]
        self._joints_of = {b: [j for j in range(model.njnt) if model.jnt_bodyid[j] == b] for b in range(model.nbody)}
        self._group = [0] * model.nbody
        for b in range(1, model.nbody):
            self._group[b] = b if self._joints_of[b] else self._group[model.body_parentid[b]]
        self._check()
        self.put({})

    def _where(self, message: str) -> str:
        """The line of what a message of MuJoCo names."""
        for element in self._root.everywhere():
            name = element.given.get("name")
            if name and f"'{name}'" in message:
                return f", line {element.line}"
        return ""

    def _line(self, tag: str, name: str) -> str:
        for element in self._root.everywhere():
            if element.tag == tag and element.given.get("name") == name:
                return f"{self._path}, line {element.line}"
        return str(self._path)

    def _check(self) -> None:
        m = self._model
        for b, joints in self._joints_of.items():
            if len(joints) > 1:
                names = ", ".join(self.joint_names[j] for j in joints)
                raise SceneError(
                    f"{self._line('body', self._names[b])}: body {self._names[b]!r} has {len(joints)} joints, {names}: "
                    "use one; put a small body between them"
                )
        for j, name in enumerate(self.joint_names):
            dof = m.jnt_dofadr[j]
            acts = {"armature": m.dof_armature, "damping": m.dof_damping, "frictionloss": m.dof_frictionloss}
            given = [key for key, values in acts.items() if values[dof]]
            given += ["range"] * bool(m.jnt_limited[j]) + ["stiffness"] * bool(m.jnt_stiffness[j])
            if m.jnt_type[j] in (FREE, BALL) and given:
                raise SceneError(
                    f"{self._line('joint', name)}: joint {name!r} is a ball or free, with {given[0]}: give it to "
                    "hinges and slides alone"
                )
        for k, count in (("tendons", m.ntendon), ("flexes", m.nflex), ("sensors", m.nsensor)):
            if count:
                self.warnings.append(f"left out: {count} {k}")

    @property
    def moving_joints(self) -> list[str]:
        """Names of hinges and slides that follow no other one."""
        m = self._model
        following = [m.eq_obj1id[e] for e in range(m.neq) if m.eq_type[e] == OF_JOINTS and m.eq_obj2id[e] >= 0]
        moving = [j for j in range(m.njnt) if m.jnt_type[j] in (SLIDE, HINGE) and j not in following]
        return [self.joint_names[j] for j in moving]

    def put(self, positions: dict[str, float]) -> None:
        """Puts joints at positions, and others where the file has them."""
        m, d = self._model, self._data
        d.qpos[:] = m.qpos0
        for name, value in positions.items():
            j = self.joint_names.index(name)
            if m.jnt_type[j] in (FREE, BALL):
                raise SceneError(
                    f"{self._line('joint', name)}: joint {name!r}: positions: give it to hinges and slides alone"
                )
            d.qpos[m.jnt_qposadr[j]] = value
        for e in range(m.neq):
            if m.eq_type[e] == OF_JOINTS and m.eq_obj2id[e] >= 0:
                follower, leader = m.eq_obj1id[e], m.eq_obj2id[e]
                ratio, offset = self._follows(e)
                at = d.qpos[m.jnt_qposadr[leader]]
                d.qpos[m.jnt_qposadr[follower]] = ratio * at + offset
        self._mj.mj_kinematics(m, d)

    def _follows(self, e: int) -> tuple[float, float]:
        """Ratio and offset of a joint that follows another one, from an equation of them."""
        m = self._model
        follower, leader = m.eq_obj1id[e], m.eq_obj2id[e]
        c = m.eq_data[e]
        if c[2:5].any():
            raise SceneError(
                f"{self._line('joint', self.joint_names[follower])}: joint {self.joint_names[follower]!r} follows "
                "another one by more than a ratio and an offset: use these"
            )
        at = [m.qpos0[m.jnt_qposadr[j]] for j in (follower, leader)]
        return float(c[1]), float(at[0] + c[0] - c[1] * at[1])

    def _place(self, position: Array) -> Array:
        placed: Array = self._base[0] + self._base[1].dot(position)
        return placed

    def _point(self, position: Array) -> tuple[float, float, float]:
        x, y, z = self._place(position).tolist()
        return x, y, z

    def _turned(self, rows: Array) -> Array:
        turned: Array = self._base[1].dot(np.reshape(rows, (3, 3)))
        return turned

    def robot(self, name: str, motors: dict[str, Motor], touches_itself: bool) -> Robot:
        """Its records."""
        m, d, bodies, visuals = self._model, self._data, dict[str, RigidBody](), dict[str, Any]()
        own = {b: f"{name}.{self._names[b]}" for b in range(1, m.nbody)}
        groups = {root: [b for b in range(m.nbody) if self._group[b] == root] for root in sorted(set(self._group))}
        for root, some in groups.items():
            geoms = [g for g in range(m.ngeom) if m.geom_bodyid[g] in some]
            touching = [g for g in geoms if m.geom_contype[g] or m.geom_conaffinity[g]]
            if root == 0:
                for each in static_shapes(m, d, touching, self._path):
                    bodies[self._static_name(name, each, bodies)] = self._static(each)
                continue
            masses = m.body_mass[some] * [self._urdf is None or self._urdf.has_mass(self._names[b]) for b in some]
            centre = masses.dot(d.xipos[some]) / masses.sum()
            R, inertia = d.xmat[root].reshape(3, 3), np.zeros((3, 3))
            for b, mass in zip(some, masses, strict=True):
                turn, arm = d.ximat[b].reshape(3, 3), d.xipos[b] - centre
                inertia += (turn * m.body_inertia[b]).dot(turn.T) + mass * (
                    arm.dot(arm) * np.eye(3) - np.outer(arm, arm)
                )
            shape = link_shape(m, d, touching, centre, R, self._line("body", self._names[root]))
            if shape.said:
                self.warnings.append(f"{own[root]}: {shape.said}")
            whole = R.T.dot(inertia).dot(R)
            bodies[own[root]] = RigidBody(
                shape.shape,
                mass=float(masses.sum()),
                inertia=(whole + whole.T) / 2,
                position=self._place(centre),
                rotation=quaternion_of(self._turned(R)),
                shape_position=shape.position,
                shape_rotation=shape.rotation,
            )
            if seen := visuals_of(m, d, [g for g in geoms if g not in touching], centre, R):
                visuals[own[root]] = seen
        if self._urdf is not None:
            self._urdf.check_size(self._size_of)
        frames = {link: self._frame(b, own) for b, link in enumerate(self._names) if b}
        joints = self._joints(name, own, motors)
        joined = [*own.values(), *bodies]
        apart = () if touches_itself else (tuple(dict.fromkeys(each for each in joined if each in bodies)),)
        return Robot(
            bodies, joints, apart, {key: Frame(*of) for key, of in frames.items()}, visuals, tuple(self.warnings)
        )

    def _static_name(self, name: str, each: StaticShape, taken: dict[str, RigidBody]) -> str:
        of = f"{name}.{self._names[each.body] if each.body else 'ground'}"
        count = sum(other == of or other.startswith(f"{of}:") for other in taken)
        return f"{of}:{count + 1}" if count else of

    def _static(self, each: StaticShape) -> RigidBody:
        return RigidBody(
            each.shape, position=self._place(each.position), rotation=quaternion_of(self._turned(each.rotation))
        )

    def _size_of(self, link: str) -> float:
        """Of the meshes of a link, m."""
        m = self._model
        if link not in self._names:
            return 0.0
        of = [g for g in range(m.ngeom) if m.geom_bodyid[g] == self._names.index(link)]
        return 2 * max((float(m.geom_rbound[g]) for g in of), default=0.0)

    def _frame(self, b: int, own: dict[int, str]) -> tuple[str, Array, Array]:
        d, root = self._data, self._group[b]
        return own.get(root, FIXED), self._place(d.xpos[b]), quaternion_of(self._turned(d.xmat[b]))

    def _joints(self, name: str, own: dict[int, str], motors: dict[str, Motor]) -> list[AnyJoint]:
        m, d, found = self._model, self._data, list[AnyJoint]()
        followed, known = self._equations(name, own, found), self._actuators()
        for j, of in enumerate(self.joint_names):
            kind, b = m.jnt_type[j], m.jnt_bodyid[j]
            if kind == FREE:
                continue
            first, second = own.get(self._group[m.body_parentid[b]], FIXED), own[b]
            point, called = self._point(d.xanchor[j]), f"{name}.{of}"
            if kind == BALL:
                found.append(ball(first, second, point, name=called))
                continue
            drive = self._drive(j, motors.get(of, known.get(j)), followed.get(j))
            size = 0.2 if kind == SLIDE else max(0.02, 2 * float(np.sqrt(m.body_inertia[b].max() / m.body_mass[b])))
            axis = (size * self._base[1].dot(d.xaxis[j])).tolist()
            found.append((slider if kind == SLIDE else hinge)(first, second, point, axis, drive, name=called))
        return found

    def _drive(self, j: int, motor: Motor | None, follows: tuple[str, float, float] | None) -> Drive:
        m, dof, at = self._model, self._model.jnt_dofadr[j], self._model.jnt_qposadr[j]
        most = float(m.jnt_actfrcrange[j, 1]) if m.jnt_actfrclimited[j] else np.inf
        if motor is not None and most < motor.most:
            motor = Motor(motor.kind, motor.gain, motor.damping, most)
        limits = (float(m.jnt_range[j, 0]), float(m.jnt_range[j, 1])) if m.jnt_limited[j] else None
        try:
            return Drive(
                float(self._data.qpos[at]),
                limits,
                friction=float(m.dof_frictionloss[dof]),
                damping=float(np.ravel(m.dof_damping[dof])[0]),
                armature=float(m.dof_armature[dof]),
                stiffness=float(np.ravel(m.jnt_stiffness[j])[0]),
                rest=float(m.qpos_spring[at]),
                motor=motor,
                follows=follows,
            )
        except SceneError as error:
            raise SceneError(f"{self._line('joint', self.joint_names[j])}: {self.joint_names[j]!r}: {error}") from error

    def _equations(self, name: str, own: dict[int, str], found: list[AnyJoint]) -> dict[int, tuple[str, float, float]]:
        """Who follows whom; what holds bodies together is added to what was found."""
        m, d, followed = self._model, self._data, dict[int, tuple[str, float, float]]()
        for e in range(m.neq):
            kind, one, other = m.eq_type[e], m.eq_obj1id[e], m.eq_obj2id[e]
            if kind == OF_JOINTS and other >= 0:
                followed[one] = f"{name}.{self.joint_names[other]}", *self._follows(e)
            elif kind in (CONNECT, WELD) and m.eq_objtype[e] == self._mj.mjtObj.mjOBJ_BODY:
                bodies = [own.get(self._group[b], FIXED) for b in (one, other)]
                point = self._point(
                    d.xpos[one] + d.xmat[one].reshape(3, 3).dot(m.eq_data[e, :3] if kind == CONNECT else 0)
                )
                of, other_body = bodies
                found.append((ball if kind == CONNECT else weld)(of, other_body, point, name=f"{name}.equality{e}"))
            else:
                raise SceneError(f"{self._path}: equality {e}: use connect and weld of bodies, joint of two joints")
        return followed

    def _actuators(self) -> dict[int, Motor]:
        m, known = self._model, dict[int, Motor]()
        for a in range(m.nu):
            name, gear = m.actuator(a).name or f"actuator{a}", float(m.actuator_gear[a, 0])
            gain, bias = float(m.actuator_gainprm[a, 0]), m.actuator_biasprm[a, :3]
            plain = m.actuator_trntype[a] == OF_JOINT and m.actuator_gaintype[a] == FIXED_GAIN
            plain = plain and m.actuator_dyntype[a] == NONE and m.actuator_biastype[a] in (NONE, AFFINE)
            motor, most = None, np.inf
            if m.actuator_forcelimited[a]:
                most = gear * float(m.actuator_forcerange[a, 1])
            if plain and not bias.any():
                motor = Motor("torque", most=most)
            elif plain and bias[0] == 0 and bias[1] == -gain:
                motor = Motor("position", gear**2 * gain, float(-(gear**2) * bias[2]), most)
            elif plain and bias[0] == bias[1] == 0 and bias[2] == -gain:
                motor = Motor("velocity", gear**2 * gain, most=most)
            if motor is None or int(m.actuator_trnid[a, 0]) in known:
                self.warnings.append(f"left out: actuator {name!r}: use one motor, position or velocity of a joint")
            else:
                known[int(m.actuator_trnid[a, 0])] = motor
        return known
