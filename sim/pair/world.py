"""Two arms and one workpiece in PyBullet, one body with two branches, stepped a quarter of a millisecond at a time.

Links are PyBullet's; rotors, gears and the workpiece are not: they hand their torques to the joints at every step.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.pair.body import ArmTruth
from sim.pair.two_arms import TwoArms, WorldSettings
from sim.servo import TICK_S

Array = NDArray[np.float64]

#: Largest modulus of a mode of the linearised step.
STABLE = 1.0 + 1e-6


class PairWorld(TwoArms):
    """Physics of two arms that hold one part; `record` gets a row a millisecond.

    Parameters
    ----------
    arms : master and slave
    settings : WorldSettings
    """

    def __init__(self, arms: tuple[ArmTruth, ArmTruth], settings: WorldSettings) -> None:
        super().__init__(arms, settings)
        self._delay_s = np.zeros(self.joints)
        self._substeps = round(TICK_S / settings.step_s)
        self._share = TICK_S / (TICK_S + settings.filter_s)
        self.radius = self._largest_mode()
        if self.radius > STABLE:
            self.close()
            raise ValueError(
                f"the physics step of {settings.step_s * 1e3:g} ms is too long: its fastest mode grows by"
                f" {self.radius:.4f} a step; take a shorter one or a softer workpiece"
            )

    # -- setting up --------------------------------------------------------------------------------------------------

    def _stand(self, theta_rad: Array) -> None:
        super()._stand(theta_rad)
        q = self.q
        self._engine.place(q, self.qd)
        closure = self.part.at(q)
        self.part.size_damping(closure.jacobian @ np.linalg.solve(self._engine.mass(q), closure.jacobian.T))

    def _largest_mode(self) -> float:
        """Largest modulus of the eigenvalues of one step, linearised at rest."""
        train, h, n = self.motors.train, self.settings.step_s, self.joints
        rate = self.part.at(self.q).jacobian
        inverse = np.linalg.inv(self._engine.mass(self.q))
        spring, damper = np.diag(train.stiffness_nm_rad), np.diag(train.damping_nm_s_rad)
        part_spring = rate.T @ (self.part.stiffness[:, None] * rate)
        part_damper = rate.T @ (self.part.damping[:, None] * rate)
        rotor = h * np.diag(1.0 / train.rotor_kg_m2)
        zero, one = np.zeros((n, n)), np.eye(n)
        # q, qd, theta, omega; forces from the old state, angles from the new speeds
        speed = np.hstack(
            [
                -h * inverse @ (spring + part_spring),
                one - h * inverse @ (damper + part_damper),
                h * inverse @ spring,
                h * inverse @ damper,
            ]
        )
        turn_ = np.hstack([rotor @ spring, rotor @ damper, -rotor @ spring, one - rotor @ damper])
        angle = np.hstack([one, zero, zero, zero]) + h * speed
        shaft = np.hstack([zero, zero, one, zero]) + h * turn_
        return float(np.abs(np.linalg.eigvals(np.vstack([angle, speed, shaft, turn_]))).max())

    def _stretch(self, ticks: float) -> None:
        for act in self.before:
            act(ticks)
        jitter = self.settings.skew_jitter_s
        self._delay_s[self.of_arm[1]] = self.settings.skew_s + (self._random.uniform(0.0, jitter) if jitter else 0.0)
        for _ in range(round(ticks)):
            self._tick()
        self.motors.show()
        for act in self.after:
            act(self.time_s)

    def _tick(self) -> None:
        """One millisecond."""
        motors, part = self.motors, self.part
        motors.control(self._delay_s, self._share, TICK_S)
        q, qd = self.q, self.qd
        closure = part.at(q)
        rate, stiffness, damping = closure.jacobian, part.stiffness, part.damping
        base, push, wrench = closure.deviation - rate @ q, self.push, self.wrench
        for _ in range(self._substeps):
            wrench = -stiffness * (base + rate @ q) - damping * (rate @ qd)
            torque = motors.step(q, qd) + wrench @ rate
            if push is not None:
                torque = torque + push
            q, qd = (np.array(state) for state in self._engine.step(torque.tolist()))
        self.q, self.qd, self.wrench = q, qd, wrench
        self.time_s = round((self.time_s + TICK_S) / TICK_S) * TICK_S
        if self.recording:
            self._note(closure)


__all__ = ["PairWorld", "WorldSettings"]
