"""Conditions that are monitored at every SYNC under power: range, following error, speed, torque, movement, contact.

Every condition is a value per joint with a limit per joint. `ARM_RULES` holds for how many SYNCs in a row the value may
exceed its limit, and what to do.

Contact is a jump of the unexplained torque. The model lacks the load, and friction and rotors that were not identified.
The difference between measured and modelled torque is therefore compared with its own recent mean: the load changes it
slowly, contact changes it at once.

The torque of the motion besides gravity (`OwnTorque`: identified friction, rotors and links) is that of the setpoints;
the servo lag and the load are not modelled.
"""

from __future__ import annotations

from collections import deque
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.cell.conversion import AxisConversion
from gateway.data.visit import ArmSample
from gateway.errors import LimitExceeded
from gateway.feedforward.dynamics import ArmDynamics
from gateway.feedforward.identified import AxisConstants, Known
from gateway.feedforward.law import TURN_ROUND_RAD
from gateway.identify.links import link_values
from gateway.model.regressor import gravity_regressor
from gateway.motion.arm import Arm
from gateway.motion.reactions import ARM_RULES
from gateway.motion.workspace import Workspace

Floats = NDArray[np.float64]
#: Tolerance of the joint range for control error and rounding [rad].
POSITION_TOLERANCE_RAD = 0.02
#: Tolerance factor for the measured speed, which is a difference of counts.
SPEED_TOLERANCE = 1.2
#: Shortest time over which speed is measured [s].
SPEED_SPAN_S = 0.02
#: Real time: a SYNC counts as delayed from this share of a period on; length of the checked window.
DELAYED_SHARE = 0.5
RHYTHM_S = 2.0
#: Jump of the unexplained torque, as a share of the joint's torque limit; friction at a reversal is below half of it.
#: A gear that changes from driving to back-driven adds (1 / eta - eta) of the torque it carries.
CONTACT_SHARE = 0.25
#: The same for a joint with identified friction, rotor and links: the friction reversal is added by its size,
#: since the joint reverses later than its setpoints.
KNOWN_SHARE = 0.15
#: Time constant of the recent mean [s].
MEMORY_S = 0.5
#: A delayed SYNC makes the drives wait and start again: contact is not checked until the oscillation has decayed.
DELAY_GRACE_S = ARM_RULES["late_sync"].limit
#: After the brakes open, the drives take over the torque that the brakes have carried; nothing moves yet.
TAKE_OVER_S = 0.3
#: Commanded movement after which a joint has to follow, and the share of it that it has to move. A joint that lags at
#: speed and reverses has moved less, but is then close to its target.
FOLLOW_RAD = ARM_RULES["stays_behind"].limit
FOLLOW_SHARE = 0.2
_JUMP: Final = ": the torque has jumped by {value:.0f} Nm, more than the limit of {limit:.0f} Nm plus the effect of a"
#: Rule and message of each condition. Jumps up and down are counted apart: delayed setpoints make the torque
#: oscillate, which does not indicate contact.
CONDITIONS: Final = (
    ("range", " is at {q_rad:.3f} rad, outside its range"),
    ("limits", " is {value:.3f} rad off its target, its limit is {limit:g} rad"),
    ("limits", " turns with {value:.3f} rad/s, its limit is {limit:g} rad/s"),
    ("limits", " needs {value:.0f} Nm, its limit is {limit:g} Nm"),
    ("stays_behind", " was commanded to move by {commanded_rad:.3f} rad but has moved by {moved_rad:.3f} rad"),
    ("contact", f"{_JUMP} reversal"),
    ("contact", f"{_JUMP} reversal"),
)
#: Number of SYNCs in a row that stop the arm: one noisy reading does not. A limit of movement acts at once.
_SYNCS: Final = np.array([[max(ARM_RULES[rule].count, 1)] for rule, _ in CONDITIONS])


class OwnTorque:
    """Friction and inertia torque of one arm, updated with every setpoint.

    Parameters
    ----------
    known : tuple of AxisConstants
        Constants; only axes with identified friction and rotor are used.
    axes : AxisConversion
    workspace : Workspace
        Links of its robot; an unknown link adds no torque.
    period_s : float
        SYNC period.

    Attributes
    ----------
    turning_nm : array of shape (N,)
        Largest change of each joint's friction torque at a reversal; NaN where not identified.
    """

    def __init__(
        self, known: tuple[AxisConstants, ...], axes: AxisConversion, workspace: Workspace, period_s: float
    ) -> None:
        used = np.array([watched(axis) for axis in known])
        self._coupling, self._period_s, self._used = axes.coupling, period_s, used
        self._coulomb = _of(used, [axis.coulomb_nm for axis in known])
        self._viscous = _of(used, [axis.viscous_nm_s_rad for axis in known])
        self._rotor = _of(used, [axis.rotor_kg_m2 for axis in known])
        self._links: ArmDynamics | None = None
        # not where a link is unknown, or the cell file distrusts the masses
        if workspace.links is not None and np.isfinite(workspace.robot.inertia_kg_m2).all():
            self._links = ArmDynamics(workspace.robot, link_values(workspace.robot).ravel(), np.zeros(3))
        peak = np.fmax(self._coulomb, [axis.breakaway_nm for axis in known])
        weight = np.abs(axes.coupling)
        identified = ~(weight[~used] > 0.0).any(axis=0)
        self.turning_nm = np.where(identified, 2.0 * peak @ weight, np.nan)
        self._identified = identified
        self._at: Floats | None = None
        self._rate = self._sense = np.zeros_like(self._rotor)
        self._change = np.zeros_like(self._rotor)

    def take(self, target_rad: Floats) -> None:
        """Update the motion with the setpoints (N,) [rad] of the next SYNC."""
        before = target_rad if self._at is None else self._at
        displacement = self._coupling @ (target_rad - before)
        rate = (target_rad - before) / self._period_s
        self._at, self._rate, self._change = target_rad, rate, (rate - self._rate) / self._period_s
        self._sense = np.clip(self._sense + displacement / TURN_ROUND_RAD, -1.0, 1.0)

    @property
    def friction_nm(self) -> Floats:
        """Return the friction torque (N,) [Nm] at the joints."""
        return (self._coulomb * self._sense + self._viscous * (self._coupling @ self._rate)) @ self._coupling

    @property
    def inertia_nm(self) -> Floats:
        """Return the inertia torque (N,) [Nm] of identified rotors and links at the joints."""
        if self._at is None or not self._identified.any():
            return np.zeros_like(self._rate)
        rotors = (self._rotor * (self._coupling @ self._change)) @ self._coupling
        if self._links is not None:
            rotors = rotors + self._links.torque(self._at.tolist(), self._rate.tolist(), self._change.tolist())
        return np.where(self._identified, rotors, 0.0)


def own_torque(arm: Arm, workspace: Workspace, period_s: float) -> OwnTorque | None:
    """Return the torque model of an arm's motion; None where nothing was identified."""
    if not any(watched(axis) for axis in arm.known):
        return None
    return OwnTorque(arm.known, arm.axes, workspace, period_s)


def watched(axis: AxisConstants) -> bool:
    """Return True if the motion torque of this axis was identified, so that contact detection uses it."""
    return all(one is not None and one.identified for one in (axis.coulomb_nm, axis.rotor_kg_m2))


def _of(used: NDArray[np.bool_], constants: list[Known | None]) -> Floats:
    """Return the values (N,) of the used axes, 0 for the others."""
    return np.array([one.value if here and one is not None else 0.0 for here, one in zip(used, constants, strict=True)])


class Watch:
    """Monitor of one arm; one instance per run.

    Parameters
    ----------
    arm : str
        Name, for messages.
    workspace : Workspace
    period_s : float
        SYNC period.
    delay_syncs : float
        Delay [SYNCs] after which a drive uses its setpoints, besides its servo lag.
    own : OwnTorque, optional
        Model of the torque of the arm's motion.

    Attributes
    ----------
    excused : array of shape (N,), bool
        Joints of which only the range is checked.
    """

    def __init__(
        self,
        arm: str,
        workspace: Workspace,
        period_s: float,
        delay_syncs: float = 0.0,
        own: OwnTorque | None = None,
    ) -> None:
        self._arm, self._workspace, self._period_s = arm, workspace, period_s
        self._delay_syncs, self._own = delay_syncs, own
        self._middle = (workspace.lower_rad + workspace.upper_rad) / 2
        self._half = (workspace.upper_rad - workspace.lower_rad) / 2 + POSITION_TOLERANCE_RAD
        self._jump_nm = CONTACT_SHARE * workspace.torque_nm
        if own is not None:
            self._jump_nm = np.fmin(self._jump_nm, KNOWN_SHARE * workspace.torque_nm + own.turning_nm)
        self._reversal = 1.0 / workspace.efficiency - workspace.efficiency
        self._mean_nm = np.zeros_like(self._half)
        self._share = min(period_s / MEMORY_S, 1.0)
        self._take_over_syncs = self._taking_over = int(np.ceil(TAKE_OVER_S / period_s))
        self._grace_syncs, self._grace = int(np.ceil(DELAY_GRACE_S / period_s)), 0
        self.excused = np.zeros(self._half.shape, dtype=bool)
        speed_rad_s, nothing = SPEED_TOLERANCE * workspace.speed_rad_s, np.zeros_like(self._half)
        fixed = (workspace.following_error_rad, speed_rad_s, workspace.torque_nm, nothing)
        self._limits = np.array([self._half, *fixed, self._jump_nm, self._jump_nm])
        self._count = np.zeros(self._limits.shape, dtype=int)
        self._target: np.ndarray | None = None
        self._from: tuple[np.ndarray, np.ndarray] | None = None
        self._sent: tuple[int, float] | None = None
        self._delayed: deque[bool] = deque(maxlen=max(20, round(RHYTHM_S / period_s)))
        self._history: deque[tuple[float, np.ndarray]] = deque(maxlen=max(2, round(SPEED_SPAN_S / period_s) + 1))

    def start(self, q_rad: np.ndarray) -> None:
        """Start monitoring an arm that holds joints (N,) [rad]; a joint outside its range may move inwards."""
        self._limits[0] = np.maximum(self._half, np.abs(q_rad - self._middle) + POSITION_TOLERANCE_RAD)

    def excuse(self, joints: np.ndarray) -> None:
        """Check only the range of joints (bool, (N,)) from now on: their drives are expected to lose torque.

        A joint that is included again starts as after enabling.
        """
        if (self.excused & ~joints).any():
            self._taking_over = self._take_over_syncs
        self.excused = joints

    def modelled_torque(self, q_rad: np.ndarray) -> np.ndarray:
        """Return the gravity torque (n, N) [Nm] of the unloaded arm at positions (n, N); 0 if the links are unknown."""
        links = self._workspace.links
        if links is None or not len(q_rad):
            return np.zeros_like(q_rad)
        return gravity_regressor(self._workspace.robot, q_rad, self._workspace.gravity_m_s2) @ links

    def moved_torque(self, q_rad: np.ndarray) -> np.ndarray:
        """Return the torque (N,) [Nm] of the unloaded arm moving to setpoints (N,).

        Gravity is taken at these setpoints. Inertia of identified rotors and links is that of earlier setpoints,
        because joints lag.
        """
        gravity_nm = self.modelled_torque(q_rad[None])[0]
        return gravity_nm if self._own is None else gravity_nm + self._own.inertia_nm

    def check(self, sample: ArmSample, target_rad: np.ndarray, modelled_nm: np.ndarray) -> None:
        """Check one SYNC; an incomplete one is skipped.

        Parameters
        ----------
        sample : ArmSample
        target_rad : array of shape (N,)
            Setpoints that were sent with this SYNC.
        modelled_nm : array of shape (N,)
            Modelled torque without friction at these setpoints: `modelled_torque`, `moved_torque`, or that of the
            trajectory.

        Raises
        ------
        LimitExceeded
            A condition of `CONDITIONS` lasted for the SYNCs of its rule.
        IncompleteEpochs
            Too many SYNCs were delayed.
        """
        expected = target_rad if self._target is None else self._target
        self._target = target_rad
        if self._own is not None:
            self._own.take(target_rad)
            modelled_nm = modelled_nm + self._own.friction_nm
        self._check_rhythm(sample)
        if not sample.complete:
            return
        q_rad, torque_nm = sample.q_rad, sample.joint_torque_nm
        self._history.append((sample.time_s, q_rad))
        first_s, first_q = self._history[0]
        speed_rad_s = (q_rad - first_q) / max(sample.time_s - first_s, 0.5 * self._period_s)
        if self.excused.any():
            expected = np.where(self.excused, q_rad, expected)
            speed_rad_s, torque_nm = np.where(self.excused, 0.0, (speed_rad_s, torque_nm))
        behind, *movement = self._movement(q_rad, expected)
        unexplained_nm = torque_nm - modelled_nm
        jump_nm = unexplained_nm - self._mean_nm
        values = np.array([q_rad - self._middle, q_rad - expected, speed_rad_s, torque_nm, behind, jump_nm, -jump_nm])
        np.abs(values[:4], out=values[:4])
        if self._delay_syncs:
            values[1] -= self._delay_syncs * np.abs(target_rad - expected)
        over = values > self._limits
        if over.any():
            carried_nm = np.maximum(np.abs(torque_nm), np.abs(modelled_nm + self._mean_nm))
            over[-2:] &= (values[-2:] > self._jump_nm + self._reversal * carried_nm) & ~self.excused
            over[-2:] &= self._taking_over == self._grace == 0
        self._count = (self._count + 1) * over
        if (self._count >= _SYNCS).any():
            kind, joint = np.argwhere(self._count >= _SYNCS)[0].tolist()
            rule, message = CONDITIONS[kind]
            what = message.format(
                value=values[kind, joint],
                limit=self._limits[kind, joint],
                q_rad=q_rad[joint],
                commanded_rad=movement[0][joint],
                moved_rad=movement[1][joint],
            )
            raise LimitExceeded(
                f"arm '{self._arm}', joint {joint + 1}{what}: {ARM_RULES[rule].advice}", joint=joint + 1
            )
        if (self._limits[0] > self._half).any():  # the tolerance of a joint that started outside narrows as it moves in
            inward_rad = np.minimum(self._limits[0], values[0] + POSITION_TOLERANCE_RAD)
            self._limits[0] = np.maximum(self._half, inward_rad)
        if self._taking_over:
            self._mean_nm = unexplained_nm
        elif not over[-2:].any():
            self._mean_nm = self._mean_nm + self._share * jump_nm
        self._taking_over, self._grace = max(self._taking_over - 1, 0), max(self._grace - 1, 0)

    def _movement(self, q_rad: np.ndarray, target_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return which joints (N,) stay behind; commanded and measured movement (N,) [rad] since the last check."""
        if self._from is None:
            self._from = (q_rad.copy(), target_rad.copy())
        start_q, start_target = self._from
        commanded, moved = target_rad - start_target, q_rad - start_q
        far = np.abs(commanded) > FOLLOW_RAD
        if not far.any():
            return far, commanded, moved
        lags = np.abs(target_rad - q_rad) > (1.0 - FOLLOW_SHARE) * FOLLOW_RAD
        start_q[far], start_target[far] = q_rad[far], target_rad[far]
        return far & lags & (moved * np.sign(commanded) < FOLLOW_SHARE * np.abs(commanded)), commanded, moved

    def _check_rhythm(self, sample: ArmSample) -> None:
        """Count delayed SYNCs; too many of them stop the arm."""
        before, self._sent = self._sent, (sample.sync_index, sample.time_s)
        if before is None:
            return
        on_time_s = before[1] + (sample.sync_index - before[0] + DELAYED_SHARE) * self._period_s
        self._delayed.append(sample.time_s > on_time_s)
        if not self._delayed[-1]:
            return
        self._grace = self._grace_syncs
        delayed, rule = sum(self._delayed), ARM_RULES["rhythm"]
        if delayed > rule.limit * (self._delayed.maxlen or 1):
            raise rule.raised(f"arm '{self._arm}': {delayed} of the last {len(self._delayed)} SYNCs were delayed")
