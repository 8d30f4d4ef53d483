"""Limits that are monitored at every SYNC while the arm moves: position, speed, torque, following error, contact."""

from __future__ import annotations

from collections import deque

import numpy as np

from gateway.data.sample import ArmSample
from gateway.errors import LimitExceeded
from gateway.model.regressor import gravity_regressor
from gateway.motion.contact import Contact
from gateway.motion.own_torque import OwnTorque
from gateway.motion.reactions import ARM_RULES
from gateway.motion.workspace import Workspace

#: Number of consecutive SYNCs above a limit that stop the arm: one noisy reading does not.
IN_A_ROW = ARM_RULES["limits"].count
#: Tolerance of the joint range for control error and rounding [rad].
POSITION_TOLERANCE_RAD = 0.02
#: Tolerance factor for the measured speed, which is a difference of counts.
SPEED_TOLERANCE = 1.2
#: Shortest time over which speed is measured [s].
SPEED_SPAN_S = 0.02
#: Real time: a SYNC counts as delayed from this share of a period on; length of the checked window.
DELAYED_SHARE = 0.5
RHYTHM_S = 2.0

KINDS = ("is {value:.3f} rad off its target", "turns with {value:.3f} rad/s", "needs {value:.0f} Nm")
UNITS = ("rad", "rad/s", "Nm")
RANGE = 3


class Watch:
    """Limit monitor of one arm; one instance per run.

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
    """

    def __init__(
        self,
        arm: str,
        workspace: Workspace,
        period_s: float,
        delay_syncs: float = 0.0,
        own: OwnTorque | None = None,
    ) -> None:
        self._arm = arm
        self._period_s = period_s
        self._workspace = workspace
        self._middle = (workspace.lower_rad + workspace.upper_rad) / 2
        half = (workspace.upper_rad - workspace.lower_rad) / 2 + POSITION_TOLERANCE_RAD
        speed = SPEED_TOLERANCE * workspace.speed_rad_s
        self._limits = np.array([workspace.following_error_rad, speed, workspace.torque_nm, half])
        self._half = half
        self._count = np.zeros(self._limits.shape, dtype=int)
        self._counting = False
        self._target: np.ndarray | None = None
        self._delay_syncs = delay_syncs
        self._own = own
        self._contact = Contact(arm, workspace, period_s, None if own is None else own.turning_nm)
        self._sent: tuple[int, float] | None = None
        self._delayed: deque[bool] = deque(maxlen=max(20, round(RHYTHM_S / period_s)))
        self._history: deque[tuple[float, np.ndarray]] = deque(maxlen=max(2, round(SPEED_SPAN_S / period_s) + 1))

    def start(self, q_rad: np.ndarray) -> None:
        """Start monitoring an arm that holds joints (N,) [rad]; a joint outside its range may move inwards."""
        away = np.abs(q_rad - self._middle) + POSITION_TOLERANCE_RAD
        self._limits[RANGE] = np.maximum(self._half, away)

    def excuse(self, joints: np.ndarray) -> None:
        """Check only the range of joints (bool, (N,)) from now on: their drives are expected to lose torque."""
        self._contact.excuse(joints)

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
            A joint left its range, or another limit for `IN_A_ROW` SYNCs.
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
        q_rad = sample.q_rad
        self._history.append((sample.time_s, q_rad))
        first_s, first_q = self._history[0]
        span_s = max(sample.time_s - first_s, 0.5 * self._period_s)
        torque_nm = sample.joint_torque_nm
        excused = self._contact.excused
        speed_rad_s = (q_rad - first_q) / span_s
        if excused.any():
            expected = np.where(excused, q_rad, expected)
            speed_rad_s, torque_nm = np.where(excused, 0.0, (speed_rad_s, torque_nm))
        off_rad = q_rad - expected
        if self._delay_syncs:
            delay_rad = self._delay_syncs * np.abs(target_rad - expected)
            off_rad = np.sign(off_rad) * np.maximum(np.abs(off_rad) - delay_rad, 0.0)
        values = np.array([off_rad, speed_rad_s, torque_nm, q_rad - self._middle])
        over = np.abs(values) > self._limits
        if over.any():
            self._count = (self._count + 1) * over
            self._counting = True
            self._refuse(values, q_rad)
        elif self._counting:
            self._count[:] = 0
            self._counting = False
        self._narrow(q_rad)
        self._contact.check(q_rad, torque_nm, modelled_nm, expected)

    def _narrow(self, q_rad: np.ndarray) -> None:
        """Narrow the tolerance of a joint that started outside its range as it moves in."""
        reach = self._limits[RANGE]
        if (reach > self._half).any():
            inward = np.minimum(reach, np.abs(q_rad - self._middle) + POSITION_TOLERANCE_RAD)
            self._limits[RANGE] = np.maximum(self._half, inward)

    def _check_rhythm(self, sample: ArmSample) -> None:
        """Count delayed SYNCs; too many of them stop the arm."""
        before, self._sent = self._sent, (sample.sync_index, sample.time_s)
        if before is None:
            return
        on_time_s = before[1] + (sample.sync_index - before[0] + DELAYED_SHARE) * self._period_s
        self._delayed.append(sample.time_s > on_time_s)
        if not self._delayed[-1]:
            return
        self._contact.note_delayed_sync()
        delayed, rule = sum(self._delayed), ARM_RULES["rhythm"]
        if delayed > rule.limit * (self._delayed.maxlen or 1):
            raise rule.raised(f"arm '{self._arm}': {delayed} of the last {len(self._delayed)} SYNCs were delayed")

    def _refuse(self, values: np.ndarray, q_rad: np.ndarray) -> None:
        if self._count[RANGE].any():
            joint = int(np.argmax(self._count[RANGE]))
            raise LimitExceeded(
                f"arm '{self._arm}', joint {joint + 1} is at {q_rad[joint]:.3f} rad, outside its range: "
                f"{ARM_RULES['range'].advice}",
                joint=joint + 1,
            )
        if self._count.max() >= IN_A_ROW:
            kind, joint = np.argwhere(self._count >= IN_A_ROW)[0]
            what = KINDS[kind].format(value=abs(values[kind, joint]))
            limit = f"{self._limits[kind, joint]:g} {UNITS[kind]}"
            raise LimitExceeded(
                f"arm '{self._arm}', joint {joint + 1} {what}, its limit is {limit}: {ARM_RULES['limits'].advice}",
                joint=int(joint) + 1,
            )
