"""The arm in PyBullet, stepped one millisecond at a time, without a clock.

Links are PyBullet's. Motors are not: each rotor is integrated here, behind its gear, and hands its torque to the link
through a stiff, damped coupling (PyBullet has no rotor inertia). Friction therefore acts where it does in a machine,
between motor and gear output, and is exact at rest. The coupling is numerical: the encoder does not measure its
wind-up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from sim.cellfile import ArmSpec
from sim.engine import Engine
from sim.friction import JointFriction
from sim.motor import AMBIENT_C, MotorAxis
from sim.plant import Payload, Plant
from sim.servo import TICK_S
from sim.tuning import Coupling, coupling, coupling_at_once, servo_loops
from sim.urdf import SimBody, SimChain, combine

Array = NDArray[np.float64]


#: Milliseconds after which springs, drift and payload shift are looked at again.
REFRESH_TICKS = 20
#: Displacement of the payload after which the links are built again [m].
SHIFT_M = 1e-4


class ArmWorld:
    """Physics of one arm.

    Parameters
    ----------
    arm : cell's description: chain, axes, coupling
    plant : true physics
    seed : of the noise
    filters_s : (N,) time constants of the drives' torque filters [s]; 0.001 if not given
    """

    def __init__(self, arm: ArmSpec, plant: Plant, seed: int, filters_s: Sequence[float] = ()) -> None:
        self.plant = plant
        self.time_s = 0.0
        self._chain = arm.chain
        self._coupling = None if np.array_equal(arm.coupling, np.eye(len(arm.axes))) else arm.coupling
        self._zero = np.array([axis.zero_offset_rad for axis in arm.axes])
        self._limits = np.array([axis.position_limit_rad for axis in arm.axes])
        self._noise = np.random.default_rng(seed)
        home = np.clip(arm.start_rad or 0.0, self._limits[:, 0], self._limits[:, 1])
        self._q, self._qd = home.tolist(), [0.0] * len(home)
        self._now = plant.at(0.0)
        self._refreshed_s = 0.0
        self._passive: list[float] | None = None
        self._shown = np.zeros(len(home))
        self._engine = self._built()
        loops = servo_loops(arm, self._masses(), plant.rotor_inertia_kg_m2)
        filters = tuple(filters_s) or (0.001,) * len(loops)
        self.axes = [MotorAxis(servo, JointFriction(seed * 8 + i), filters[i]) for i, servo in enumerate(loops)]
        for i, axis in enumerate(self.axes):
            axis.winding_c = partial(self._winding_c, i)
        self._tune()
        self._take_over()
        self._settle()

    # ------------------------------------------------------------------------------------------------------- set-up

    def _built(self) -> Engine:
        """Build the links with the mounted load, in the present posture."""
        self._loaded = self._now.payload
        engine = Engine([physical_chain(self._chain, self._now)], self._now.gravity_m_s2)
        engine.place(self._q, self._qd)
        return engine

    def _postures(self) -> list[Array]:
        low, high = self._limits.T
        shares = np.random.default_rng(0).uniform(0.1, 0.9, (12, len(low)))
        return [np.array(self._q), *(low + shares * (high - low))]

    def _winding_c(self, motor: int) -> float:
        """Temperature of a motor now; that of the surroundings where the plant has none."""
        warm = self.plant.temperature_c
        return AMBIENT_C if warm is None else float(warm(self.time_s)[motor])

    def _masses(self) -> list[Array]:
        """Mass matrices (N, N) on the motor side of a coupling, in the present and twelve other postures."""
        return [self._mass(q) for q in self._postures()]

    def _mass(self, q_rad: Sequence[float] | Array) -> Array:
        inverse = np.eye(len(self._q)) if self._coupling is None else np.linalg.inv(self._coupling)
        return inverse.T @ self._engine.mass(q_rad) @ inverse

    def _tune(self) -> None:
        """Size the numerical coupling for the mounted load."""
        rotor = self.plant.rotor_inertia_kg_m2
        self._gears: Coupling = coupling(self._masses(), rotor)
        for i, axis in enumerate(self.axes):
            axis.step = float(TICK_S / rotor[i])

    def _retune(self) -> None:
        """Take over the present posture where all axes are coupled at once; no torque changes by that."""
        if self._gears.at_once:
            angles = self._motor_angles()
            wound = [axis.theta_rad - angle for axis, angle in zip(self.axes, angles, strict=True)]
            torque = (self._gears.stiffness @ wound).tolist()
            self._gears = coupling_at_once(self._mass(self._q), self.plant.rotor_inertia_kg_m2)
            for axis, angle, ahead in zip(self.axes, angles, self._gears.wound_rad(torque), strict=True):
                axis.theta_rad = angle + ahead

    def _take_over(self) -> None:
        """Hand the present plant's numbers to gears and encoders."""
        now = self._now
        self._engine.set_gravity(now.gravity_m_s2)
        shift = now.zero_offset_rad + self._zero
        shift = shift if self._coupling is None else self._coupling @ shift
        for i, axis in enumerate(self.axes):
            axis.compliance_rad_nm, axis.shift_rad = float(now.compliance_rad_nm[i]), float(shift[i])
            gear = axis.friction
            gear.coulomb_nm, gear.stiction_nm = float(now.coulomb_nm[i]), float(now.stiction_nm[i])
            gear.viscous_nm_s_rad, gear.load_friction = float(now.viscous_nm_s_rad[i]), float(now.load_friction[i])
            gear.bias_nm, gear.creep_rad_s = float(now.friction_bias_nm[i]), float(now.creep_rad_s[i])
            gear.scatter = float(now.friction_scatter[i])
            gear.set_efficiency(float(now.gear_efficiency[i]))

    def _settle(self) -> None:
        """Wind the couplings up to gravity, so that the arm is at rest in its brakes from the start."""
        still = [0.0] * len(self._q)
        self._qd = still
        self._passive = self._passive_torque()
        need = self._engine.needed_nm(self._q, still, still) - (self._passive or 0.0)
        angle = np.array(self._q)
        if self._coupling is not None:
            need, angle = np.linalg.solve(self._coupling.T, need), self._coupling @ angle
        wound = self._gears.wound_rad(need.tolist())
        for axis, torque, q, ahead in zip(self.axes, need.tolist(), angle.tolist(), wound, strict=True):
            axis.torque_nm = torque
            axis.theta_rad = q + ahead
            axis.position_rad = q + axis.compliance_rad_nm * torque - axis.shift_rad
            axis.omega_rad_s = 0.0
            axis.servo.reference_rad = axis.position_rad

    # ---------------------------------------------------------------------------------------------------- operation

    def mount(self, payload: Payload) -> None:
        """Mount another load on the last link; an arm held by its brakes does not move."""
        self.plant = self.plant.with_payload(payload)
        self._now = self.plant.at(self.time_s)
        self._engine.close()
        self._engine = self._built()
        self._tune()
        self._take_over()
        if any(axis.free for axis in self.axes):
            wound = self._gears.wound_rad([axis.torque_nm for axis in self.axes])
            for axis, q, ahead in zip(self.axes, self._motor_angles(), wound, strict=True):
                axis.theta_rad = q + ahead
        else:
            self._settle()

    def advance(self, ticks: int) -> None:
        """Step the physics by whole milliseconds."""
        while ticks > 0:
            self._refresh()
            self._retune()
            self._step(min(ticks, REFRESH_TICKS))
            ticks -= REFRESH_TICKS

    def _step(self, ticks: int) -> None:
        axes = self.axes
        for axis in axes:
            axis.shown_sum_nm = 0.0
        for _ in range(ticks):
            a, b = (self._q, self._qd) if self._coupling is None else self._coupled()
            wound = [axis.theta_rad - angle for axis, angle in zip(axes, a, strict=True)]
            turning = [axis.omega_rad_s - speed for axis, speed in zip(axes, b, strict=True)]
            forces = self._gears.torque(wound, turning)
            for axis, angle, force in zip(axes, a, forces, strict=True):
                MotorAxis.tick(axis, angle, force)
            if self._coupling is not None:
                forces = (np.array(forces) @ self._coupling).tolist()
            if self._passive is not None:
                forces = [force + passive for force, passive in zip(forces, self._passive, strict=True)]
            self._q, self._qd = self._engine.step(forces)
        self._shown = np.array([axis.shown_sum_nm for axis in axes]) / ticks
        self.time_s += ticks * TICK_S

    def _coupled(self) -> tuple[list[float], list[float]]:
        both = np.array([self._q, self._qd]) @ self._coupling.T  # type: ignore[union-attr]
        return both[0].tolist(), both[1].tolist()

    def _motor_angles(self) -> list[float]:
        return self._q if self._coupling is None else self._coupled()[0]

    def _passive_torque(self) -> list[float] | None:
        passive = self._now.passive_torque
        if passive is None:
            return None
        return np.asarray(passive(np.array(self._q), self.time_s, self.joint_torque_nm())).tolist()

    def _refresh(self) -> None:
        if (self.plant.drift or self.plant.payload_shift) and self.time_s >= self._refreshed_s + REFRESH_TICKS * TICK_S:
            self._refreshed_s = self.time_s
            self._now = self.plant.at(self.time_s)
            loaded, load = self._loaded, self._now.payload
            if load.mass_kg != loaded.mass_kg or np.abs(load.com_m - loaded.com_m).max() > SHIFT_M:
                self._engine.close()
                self._engine = self._built()
            self._take_over()
        if self._now.passive_torque is not None:
            self._passive = self._passive_torque()

    def joint_torque_nm(self) -> Array:
        """Torque that each gear transmits to its joint, shape (N,) [Nm]; `tau` of `sim.plant`."""
        torque = np.array([axis.torque_nm for axis in self.axes])
        return torque if self._coupling is None else self._coupling.T @ torque

    @property
    def q_rad(self) -> Array:
        """True joint angles, shape (N,) [rad]."""
        return np.array(self._q)

    @property
    def qd_rad_s(self) -> Array:
        """True joint speeds, shape (N,) [rad/s]."""
        return np.array(self._qd)

    def reading_nm(self) -> Array:
        """One reading of the motor torques, shape (N,), gear output side [Nm]: `r` of `sim.plant`.

        The mean over the stretch of time that was stepped last, as a drive reports it that averages between setpoints:
        its speed feedforward makes the torque a saw tooth in step with them.
        """
        now = self._now
        u = self._shown
        shown = now.current_factor * u / now.torque_constant_scale
        live = np.array([axis.fed for axis in self.axes])
        error = now.reading_offset_nm
        if now.reading_ripple is not None:
            error = error + now.reading_ripple(np.array([axis.position_rad for axis in self.axes]), u)
        shown = now.torque_sign * (now.coupling @ (shown + error * live))
        return shown + live * now.reading_noise_nm * self._noise.standard_normal(len(shown))

    def close(self) -> None:
        """Release the physics engine."""
        self._engine.close()


def physical_chain(chain: SimChain, plant: Plant) -> SimChain:
    """The chain with the plant's inertials, the payload joined to the last link as one body."""
    inertials = zip(plant.link_mass_kg.tolist(), plant.link_com_m, plant.link_inertia_kg_m2, strict=True)
    bodies = [SimBody(*inertial) for inertial in inertials]
    load = plant.payload
    if load.mass_kg > 0.0:
        bodies[-1] = combine(bodies[-1], SimBody(load.mass_kg, load.com_m, load.inertia_kg_m2))
    return replace(chain, bodies=tuple(bodies))
