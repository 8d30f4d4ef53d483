"""Passes of an excitation trajectory: several periods without a stop, at a share of the planned speed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.cell.config import ArmConfig
from gateway.data.labels import BARE_LABEL
from gateway.data.period import PeriodLabel, harmonics_of, why_aliased
from gateway.data.visit import ArmSample
from gateway.errors import ConfigError, PlanRefused
from gateway.excite.excitation import Excitation, MovingPlan, fingerprint
from gateway.feedforward.identified import AxisConstants, Known, axis_constants, drawn_parameters
from gateway.model.motion import SMOOTH_RAD_S
from gateway.model.regressor import regressor
from gateway.motion.setpoints import MotionSetpoints, PerArm
from gateway.motion.trajectory import Motion
from gateway.motion.watch import watched
from gateway.motion.workspace import Workspace

Floats = NDArray[np.float64]

#: Share of its speed at which the first excitation is driven once with a new load.
TRIED_SPEED: Final = 0.25
#: Rest before each pass [s]: following errors settle, so that the first period begins like the others.
REST_S: Final = 0.3
#: Tolerance for rounding [rad, rad/s].
HAIR: Final = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Pass:
    """Step: periods of one excitation that are driven without a stop between them, after a rest of `REST_S`.

    Attributes
    ----------
    excitation : Excitation
    speed : float
        Share of the planned speed.
    periods : tuple of int
        Their numbers, from 1.
    motion : Motion
        Motion of one period at that speed.
    modelled_nm : array of shape (n, N) or None
        Modelled joint torque [Nm] of one period without contact; None = gravity of the unloaded arm.
    """

    excitation: Excitation
    speed: float
    periods: tuple[int, ...]
    motion: Motion
    modelled_nm: Floats | None = None

    @property
    def duration_s(self) -> float:
        """Duration of all periods."""
        return len(self.periods) * self.motion.duration_s

    def label(self, load: str, period: int) -> PeriodLabel:
        """Return the label of a period under a load."""
        it = self.excitation
        return PeriodLabel(
            load, fingerprint(it), it.name, it.kind, it.joint, period, self.speed, self.motion.duration_s
        )


def slowed(excitation: Excitation, speed: float, sync_period_s: float) -> Motion:
    """Return one period at a share of its speed: the same path, sampled more finely, over a whole number of SYNCs."""
    motion = excitation.motion(speed * sync_period_s)
    return Motion(motion.q_rad, speed * motion.qd_rad_s, speed**2 * motion.qdd_rad_s2, sync_period_s)


def passes_of(
    plan: MovingPlan,
    load: str,
    driven: frozenset[tuple[int, float, int]],
    speed: float,
    sync_period_s: float,
) -> tuple[Pass, ...]:
    """Return the passes to drive under a load, without the periods that are already recorded.

    Parameters
    ----------
    plan : MovingPlan
    load : str
        For a load other than `none`, the first excitation is first driven once at `TRIED_SPEED` of the speed.
    driven : set of (fingerprint, speed, period)
        Complete periods under this load.
    speed : float
        Share of the planned speed.
    sync_period_s : float
    """
    passes = []
    tried = TRIED_SPEED * speed
    if load != BARE_LABEL and not any(each == fingerprint(plan.excitations[0]) for each, _, _ in driven):
        first = plan.excitations[0]
        passes.append(Pass(first, tried, (1,), slowed(first, tried, sync_period_s)))
    for excitation in plan.excitations:
        shape = fingerprint(excitation)
        missing = tuple(k for k in range(1, excitation.periods + 1) if (shape, speed, k) not in driven)
        if missing:
            passes.append(Pass(excitation, speed, missing, slowed(excitation, speed, sync_period_s)))
    return tuple(passes)


def check_pass(arm: str, one: Pass, axes: int) -> None:
    """Refuse a motion whose periods are not continuous, or whose samples do not determine the motion.

    `check_moving_plan` checks the limits of the arm.

    Raises
    ------
    PlanRefused
    """
    name, motion = f"arm '{arm}', motion '{one.excitation.name}'", one.motion
    rows = (motion.q_rad, motion.qd_rad_s, motion.qdd_rad_s2)
    if any(values.shape != (len(motion), axes) or not np.isfinite(values).all() for values in rows):
        raise PlanRefused(f"{name}: the motion must hold finite numbers for {axes} joints")
    moves = max(np.abs(motion.qd_rad_s[-1]).max(), np.abs(motion.q_rad[-1] - one.excitation.start_rad).max())
    if moves > HAIR:
        raise PlanRefused(
            f"{name}: a period must end at rest in its start posture so that it can repeat; this one does not"
        )
    reason = why_aliased(len(motion), harmonics_of(one.excitation.plain()))
    if reason is not None:
        raise PlanRefused(f"{name}: {reason}")


def free_torque_nm(
    workspace: Workspace, arm: ArmConfig, motion: Motion, known: Sequence[AxisConstants] = ()
) -> Floats | None:
    """Return the modelled torque (n, N) [Nm] of the unloaded arm for a motion; None where a link is unknown.

    Links are taken from the URDF; rotors are the identified ones, else those of the cell file. Friction is that of the
    cell file: the torque watch adds identified friction itself. Unknown terms are left out.

    Parameters
    ----------
    workspace : Workspace
    arm : ArmConfig
    motion : Motion
    known : sequence of AxisConstants, one per axis, optional
        Defaults to those of the arm.
    """
    try:
        links = drawn_parameters(workspace.robot, arm)
    except ConfigError:
        return None
    q, qd, qdd = motion.q_rad, motion.qd_rad_s, motion.qdd_rad_s2

    constants = known or axis_constants(arm, None)
    typed = np.array([not watched(axis) for axis in constants])

    def said(values: Iterable[Known | None]) -> Floats:
        return np.array([0.0 if value is None else value.value for value in values])

    bodies = regressor(workspace.robot, q, qd, qdd, workspace.gravity_m_s2) @ links
    dry = typed * said(axis.coulomb_nm for axis in constants) * np.tanh(qd / SMOOTH_RAD_S)
    viscous = typed * said(axis.viscous_nm_s_rad for axis in constants)
    return bodies + said(axis.rotor_kg_m2 for axis in constants) * qdd + dry + viscous * qd


#: Called with the sample's index within the period, the period's index, the sample, and the targets of its SYNC.
Taken = Callable[[int, int, ArmSample, np.ndarray], None]


class PeriodicSetpoints(MotionSetpoints):
    """Setpoint source that repeats one period without a stop; every sample at full speed is passed on.

    Parameters
    ----------
    start_rad : array of shape (N,)
        Last setpoint of the arm.
    motion : Motion
        One period.
    periods : int
    modelled_nm : array of shape (n, N) or None
        Modelled torque of each sample of a period; None = gravity of the unloaded arm.
    taken : callable
    """

    def __init__(
        self, start_rad: np.ndarray, motion: Motion, periods: int, modelled_nm: Floats | None, taken: Taken
    ) -> None:
        q, qd, qdd = (np.tile(rows, (periods, 1)) for rows in (motion.q_rad, motion.qd_rad_s, motion.qdd_rad_s2))
        super().__init__((start_rad,), (Motion(q, qd, qdd, motion.period_s),))
        self._period_rows, self._modelled, self._taken = len(motion), modelled_nm, taken

    def modelled(self, at: float) -> PerArm | None:
        """Return the modelled torque; see `SetpointSource.modelled`."""
        return None if self._modelled is None else (self._modelled[max(int(at), 0) % self._period_rows],)

    def take(self, at: float, rate: float, samples: Sequence[ArmSample]) -> None:
        """Pass on a measured sample; none while the arm decelerates to a stop."""
        if rate == 1.0:
            period, row = divmod(round(at), self._period_rows)
            self._taken(row, period, samples[0], self.targets(at, rate)[0])
