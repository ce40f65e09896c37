"""MuJoCo moves a robot, fenics_rom the soft parts on it: poses and twists go one way, wrenches the other.

Each step MuJoCo goes first, under the wrenches of the step before, and the world follows to where the robot's bodies
are. So the robot gets what is due a step late, and the coupling as a whole adds or takes

    h Σ (w - w⁻)·(v̂, ω̂)        w: wrenches of the bases on the soft parts, w⁻ those of the step before

over the motion that both share. Both simulators close accounts of their own; this is what is between them, and
`CouplingAccount` keeps it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

import fenics_rom as fr

Array = np.ndarray


@dataclass
class CouplingAccount:
    """What went between the simulators.

    Attributes:
        given: work of the robot on the soft parts, J.
        passed: sum of the sizes of what was given in each step, J.
        added: what the delay of wrenches added to the energy of both, J; negative: took.
    """

    given: float = 0.0
    passed: float = 0.0
    added: float = 0.0


class Robot:
    """A robot of MuJoCo's as a world's driven bodies see it.

    Args:
        model: of the robot.
        data: its state.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData):
        self.model, self.data = model, data
        mujoco.mj_forward(model, data)

    def state(self, body: str) -> fr.BaseState:
        """Where a body is and how it moves, in world axes."""
        number = self.model.body(body).id
        twist = np.empty(6)  # angular first
        mujoco.mj_objectVelocity(self.model, self.data, mujoco.mjtObj.mjOBJ_XBODY, number, twist, 0)
        position, rotation = self.data.xpos[number].copy(), self.data.xquat[number].copy()
        return fr.BaseState(position, rotation, twist[3:], twist[:3])

    def motion(self, body: str, at: Sequence[float] = (0, 0, 0), mount: Array | None = None) -> Callable:
        """The motion of what is mounted on a body at a place, by a rotation (3, 3), for a world's driven body."""
        mount = np.eye(3) if mount is None else mount

        def motion(_: float) -> fr.BaseState:
            state = self.state(body)
            R = np.empty(9)
            mujoco.mju_quat2Mat(R, state.rotation)
            rotation = np.empty(4)
            mujoco.mju_mat2Quat(rotation, (R.reshape(3, 3) @ mount).ravel())
            arm = R.reshape(3, 3) @ at
            velocity = state.velocity + np.cross(state.angular_velocity, arm)
            return fr.BaseState(state.position + arm, rotation, velocity, state.angular_velocity)

        return motion

    def step(self, times: int = 1) -> None:
        """Advances by so many of the model's time steps, to where positions and velocities are those of the end."""
        mujoco.mj_step(self.model, self.data, times)
        mujoco.mj_forward(self.model, self.data)


class Bridge:
    """A robot and a world in turn.

    Args:
        robot: of MuJoCo's.
        world: its driven bodies that are mounted on the robot move by `Robot.motion`.
        mounts: names of soft bodies of the world, and of the robot's body that carries each.

    Raises:
        ValueError: a step of the world is not a whole number of the robot's.
    """

    def __init__(self, robot: Robot, world: fr.World, mounts: Mapping[str, str]):
        dt = robot.model.opt.timestep
        self._steps = round(world.dt / dt)  # of the robot, in one of the world
        if abs(self._steps * dt - world.dt) > 1e-12:
            raise ValueError(f"{world.dt:g} s are not a whole number of the robot's steps of {dt:g} s")
        self.robot, self.world, self.account = robot, world, CouplingAccount()
        self._mounts = {soft: robot.model.body(body).id for soft, body in mounts.items()}
        self._wrenches = {soft: (np.zeros(3), np.zeros(3)) for soft in mounts}

    def step(self, inputs: Mapping[str, Mapping[str, Sequence[float]]]) -> None:
        """Advances both by a step, the world's soft bodies under inputs."""
        data = self.robot.data
        data.xfrc_applied[:] = 0
        for soft, body in self._mounts.items():
            force, torque = self._wrenches[soft]
            arm = self.world.pose(soft).position - data.xipos[body]
            data.xfrc_applied[body] -= *force, *(torque + np.cross(arm, force))
        before = {soft: self.world.pose(soft) for soft in self._mounts}
        self.robot.step(self._steps)
        self.world.step(inputs)
        for soft, last in self._wrenches.items():
            self._wrenches[soft] = wrench = self.world.simulator(soft).base_wrench
            way = displacement(before[soft], self.world.pose(soft))
            given, taken = (float(w[0] @ way[0] + w[1] @ way[1]) for w in (wrench, last))
            self.account.given += given
            self.account.passed += abs(given)
            self.account.added += given - taken


def displacement(start: fr.BaseState, end: fr.BaseState) -> tuple[Array, Array]:
    """How far a base went, m, and turned, rad, in world axes."""
    between, turn = np.empty(4), np.empty(3)
    mujoco.mju_negQuat(between, start.rotation)
    mujoco.mju_mulQuat(between, end.rotation, between)
    mujoco.mju_quat2Vel(turn, between, 1.0)
    return end.position - start.position, turn
