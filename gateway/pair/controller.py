"""Coordination controller of the pair: computes both gripper commands per control cycle from forces, without I/O.

Per command `m` the slave's command is the master's through the function of arc length, `B2_T_E2 = inv(W_T_B2) W_T_B1
command T(s[m])` (CN104379308 eq. (4)), plus the corrections of the yielding hands. Function and corrections change only
between two cycles: functions are exchanged at m = 0, corrections start from zero there.

The embodiments of CN104379308 are configurations of the same components. Each row names the first function that it
needs, which hand yields to force, and what is learned; the controller does not depend on a row's name.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from gateway.errors import ConfigError, InputError, PlanRefused
from gateway.pair.calibration import PairCalibration, PathWrenches
from gateway.pair.force import AVERAGED_S, InternalForce, dead_band
from gateway.pair.impedance import Admittance, Gains, lag_of_correction_s, refuse_unstable
from gateway.pair.inverse import GearChain
from gateway.pair.iterative_learning import Cycle, IterativeLearning, Learned
from gateway.pair.learning_points import Feature, Selection
from gateway.pair.learning_update import Forgetting, LearningRule, led, smoothed
from gateway.pair.path import PairPath
from gateway.pair.transform import Floats, apply_correction, corrected_pose, correction_between, inverse
from gateway.pair.transform_function import TransformFunction
from gateway.result.pair import CycleSummary

LENGTH_TOLERANCE = 1e-4
#: Force that a taught function leaves at rest, and difference of the servo lags of two arms, standard deviations [N],
#: [s].
TAUGHT_N, LAG_DIFFERENCE_STD_S = 8.0, 0.002
#: How much later than at its command a gap is read that is left there, by the loop time: hands that answer it meanwhile
#: are ahead of the loop. From 0 to 1 learning settled, at 1.5 it built up from cycle to cycle (example cell).
GAP_LEAD = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class ControllerState:
    """State of the controller between two cycles."""

    cycle: int
    frozen: bool
    first: TransformFunction
    second: TransformFunction | None
    in_use: str
    points: np.ndarray
    margin: float
    lead_s: float


class PairController:
    """Coordination controller of one embodiment on one path.

    Parameters
    ----------
    config : Embodiment
    path : PairPath
    calibration : PairCalibration
    first_function : TransformFunction
    chain : GearChain, optional
        Compliance between the hands; by default from the calibration's stiffness.

    Raises
    ------
    ConfigError
        Impedance too close to oscillation; hands that yield without effect.
    InputError
        The function reaches beyond the path.
    """

    def __init__(
        self,
        config: Embodiment,
        path: PairPath,
        calibration: PairCalibration,
        first_function: TransformFunction,
        chain: GearChain | None = None,
    ) -> None:
        if first_function.s_m[-1] > path.length_m * (1.0 + LENGTH_TOLERANCE):
            raise InputError(
                f"the function's last knot is at {first_function.s_m[-1]:.4g} m, the path is only"
                f" {path.length_m:.4g} m long: the function belongs to another path"
            )
        self._config, self._path, self._calibration, self._chain = config, path, calibration, chain
        yielding = {"none": (), "slave": (1,), "master": (0,), "both": (0, 1)}[config.corrects]
        gains = config.gains.doubled() if len(yielding) == 2 else config.gains
        self._hands = [Admittance(gains, path.dt_s) if arm in yielding else None for arm in (0, 1)]
        self._distance = config.sensing == "distance"
        stiffness = np.eye(6) if self._distance else calibration.chain_stiffness
        self._band = np.repeat(np.asarray(config.dead_band, dtype=float), 3)
        self._banded = bool(self._band.any())
        self._shared = inverse(calibration.w_t_b2) @ calibration.w_t_b1
        slave = self._plain_slave = self._shared @ path.commands @ first_function.many(path.s_m)
        self._wrenches = PathWrenches(calibration, path, slave)
        tips = (calibration.w_t_b1 @ path.commands[0])[:3, 3], (calibration.w_t_b2 @ slave[0])[:3, 3]
        levers = [tips[1] - tips[arm] for arm in yielding]
        self._margin = refuse_unstable(gains, stiffness, calibration.loop_time_s, levers) if levers else np.inf
        rule = config.learning
        self._figure = 0 if rule is None else rule.figure
        if config.corrects == "master" and self._figure == 14:
            raise ConfigError(
                "pair: with fig. 14 the slave follows the master's corrected command, so a master that yields alone"
                " changes nothing between the hands; let the slave yield too, or use fig. 15"
            )
        self._lead_s = 0.0
        if rule is not None and yielding:
            estimate = lag_of_correction_s(config.gains, stiffness, calibration.loop_time_s)
            self._lead_s = estimate if rule.lead_s is None else rule.lead_s
        self._first = first_function
        self._learning = (
            None
            if rule is None
            else IterativeLearning(rule, path, calibration, first_function, round(self._lead_s / path.dt_s))
        )
        self._cycle, self._frozen, self._running = 0, False, False

    def start_cycle(self, begun: Floats | None = None) -> None:
        """Begin a cycle at rest at the start: reset the corrections, use the newly learned function if it is ready.

        Parameters
        ----------
        begun : array of shape (n, 6), optional
            Additional corrections of the slave at the first commands, from its present pose to the function.
        """
        self._begun = np.zeros((0, 6)) if begun is None else begun
        count, commands = len(self._path), self._path.commands
        for admittance in self._hands:
            if admittance is not None:
                admittance.reset()
        self._function = self.function
        self._relations = self._function.many(self._path.s_m)
        if self._learning is not None and self._learning.master_offset.any():
            commands = apply_correction(commands, self._learning.master_offset)
        self._master_base = commands
        self._slave_base = self._shared @ commands @ self._relations
        self._corrections = np.zeros((count, 2, 6))
        self._measured = np.full((count, 2, 4, 4), np.nan)
        self._force = np.zeros((count, 6))
        self._visited = np.zeros(count, dtype=bool)
        self._blind = -1
        self._cycle += 1
        self._running = True

    def step(
        self,
        m: int,
        wrench_1: Floats | None,
        wrench_2: Floats | None,
        measured: tuple[Floats, Floats] | None = None,
    ) -> tuple[Floats, Floats]:
        """Return the commands of both grippers for command `m`.

        Parameters
        ----------
        m : int
            Index of the command, from 0.
        wrench_1, wrench_2 : arrays of shape (6,) or None
            What the part exerts on each gripper, at its fingertip, base axes [N, Nm]; None = not measured. With
            distance sensors `wrench_2` is what the slave's fingertip still has to move [m, rad], base axes.
        measured : two arrays of shape (4, 4), optional
            Present poses of both grippers, for rules that learn from measured positions.

        Returns
        -------
        two arrays of shape (4, 4)
            `B1_T_E1`, `B2_T_E2` [m].

        Raises
        ------
        PlanRefused
            No cycle was started, or learning from measured positions without any.
        """
        if not self._running:
            raise PlanRefused("the pair has no cycle running: start one before commanding")
        wrench = wrench_2 if self._distance else self._wrenches.internal(m, wrench_1, wrench_2)
        if wrench is not None:
            self._force[m] = wrench
        elif self._hands and self._blind < 0:
            self._blind = m
        master, slave = self._master_base[m], self._slave_base[m]
        if self._hands[0] is not None:
            master = corrected_pose(master, self._yield(0, m, wrench))
            if self._figure == 14:
                slave = self._shared @ master @ self._relations[m]
        if self._hands[1] is not None:
            slave = corrected_pose(slave, self._yield(1, m, wrench))
        if m < len(self._begun):
            slave = corrected_pose(slave, self._begun[m])
            self._corrections[m, 1] = self._corrections[m, 1] + self._begun[m]
        self._visited[m] = True
        if measured is not None:
            self._measured[m] = measured
        return master, slave

    def _yield(self, arm: int, m: int, wrench: Floats | None) -> Floats:
        """Return the correction of a hand after one more cycle; unchanged without a force measurement."""
        admittance = self._hands[arm]
        if admittance is None:
            return self._corrections[m, arm]
        if wrench is not None:
            wrench = wrench if self._distance else self._wrenches.at_tip(arm, m, wrench if arm else -wrench)
            correction = admittance.step(dead_band(wrench, self._band) if self._banded else wrench)
        else:
            correction = admittance.correction
        self._corrections[m, arm] = correction
        return correction

    def beside(self, slave: Floats) -> Floats:
        """Return the correction (6,) from the slave's first command of the next cycle to its present pose (4, 4), base
        axes.
        """
        plain = self._shared @ self._path.commands[0] @ self.function.at(float(self._path.s_m[0]))
        return correction_between(slave, plain)

    def end_cycle(self, complete: bool, internal_force: InternalForce | None = None) -> CycleSummary:
        """Finish a cycle, and learn from it if it was complete and learning is on.

        Parameters
        ----------
        complete : bool
            False when an epoch was incomplete or the arms were stopped.
        internal_force : InternalForce, optional
            The internal force of the completed trajectory, where it is available.
        """
        self._running = False
        all_visited = complete and bool(self._visited.all())
        reason = self._reason(complete, internal_force)
        learned = Learned(False, len(self._function))
        force = self._force if internal_force is None else internal_force.wrench
        if not reason and self._learning is not None:
            source = "command" if self._config.learning is None else self._config.learning.source
            corrections = self._corrections.copy()
            if source != "command":
                corrections[:, 0] = correction_between(self._measured[:, 0], self._master_base)
            if source == "measured":
                corrections[:, 1] = correction_between(self._measured[:, 1], self._slave_base)
            cycle = Cycle(
                self._master_base,
                self._slave_base,
                corrections,
                force,
                self._left(internal_force),
                self._trust(internal_force),
            )
            learned = self._learning.learn(cycle)
        size = np.linalg.norm(force[:, :3], axis=1)
        known = bool(size.any()) and not self._distance
        correction = np.linalg.norm(self._corrections[:, 1].reshape(-1, 2, 3), axis=2).max(axis=0)
        return CycleSummary(
            cycle=self._cycle,
            complete=all_visited,
            learned=learned.updated,
            reason=reason,
            function="first" if self._function is self._first else "second",
            knots=len(self._function),
            force_n=float(size.max()) if known else float("nan"),
            moment_nm=float(np.linalg.norm(force[:, 3:], axis=1).max()) if known else float("nan"),
            at_command=int(np.argmax(size)) if known else -1,
            correction_m=float(correction[0]),
            correction_rad=float(correction[1]),
            change_m=learned.change_m if learned.updated else float("nan"),
            change_rad=learned.change_rad if learned.updated else float("nan"),
        )

    def _reason(self, complete: bool, internal_force: InternalForce | None) -> str:
        """Return why a cycle is not used for learning; "" when it is, or when learning is off."""
        rule = self._config.learning
        if rule is None:
            return ""
        if not complete:
            return "an epoch was incomplete or the arms were stopped"
        if not self._visited.all():
            return f"command {int(np.argmin(self._visited)) + 1} was not run"
        if self._frozen:
            return "learning is off"
        if self._blind >= 0:
            what = "gap" if self._distance else "force"
            return f"no {what} could be determined at command {self._blind + 1}"
        if rule.source != "command" and np.isnan(self._measured).any():
            return "present positions are missing"
        if internal_force is not None and internal_force.pulled:
            return "the torques of both arms are inconsistent: an external force other than the part's acted on them"
        return ""

    def _left(self, internal_force: InternalForce | None) -> Floats | None:
        """Return the remaining correction (M, 6) [m, rad] of the slave's hand, at the commands that it belongs to."""
        rule = self._config.learning
        if rule is None or rule.source != "command" or self._hands[1] is None:
            return None
        if self._distance:
            return led(self._force, round(GAP_LEAD * self._calibration.loop_time_s / self._path.dt_s))
        if internal_force is None:
            return None
        at_tip = np.einsum("nij,nj->ni", self._wrenches.from_centre[1], internal_force.wrench)
        if self._chain is None or self._hands[0] is not None:
            return at_tip / np.diag(self._calibration.chain_stiffness)
        moved = correction_between(apply_correction(self._slave_base, self._corrections[:, 1]), self._plain_slave)
        self._chain.take(smoothed(moved, round(0.5 * AVERAGED_S / self._path.dt_s)), at_tip)
        return self._chain.move(at_tip)

    def _trust(self, internal_force: InternalForce | None) -> Floats | None:
        """Return the weight (M,) of the learned function against a first function that was taught at rest.

        Teaching at rest includes errors hidden by friction; in motion it is wrong by the difference of the servo lags
        of both arms.
        """
        if internal_force is None or self._config.first != "taught":
            return None
        straight = float(self._calibration.chain_stiffness[0, 0])
        speed = np.linalg.norm(np.gradient(self._path.commands[:, :3, 3], self._path.dt_s, axis=0), axis=1)
        taught = (TAUGHT_N + straight * LAG_DIFFERENCE_STD_S * speed) ** 2
        variance = np.linalg.eigvalsh(internal_force.covariance[:, :3, :3])[:, -1]
        return taught / (taught + variance)

    def freeze(self) -> None:
        """Switch learning off; the functions stay unchanged."""
        self._frozen = True

    def resume(self) -> None:
        """Switch learning on again."""
        self._frozen = False

    def reset(self) -> None:
        """Delete the learned functions; the next cycle uses the first function."""
        if self._learning is not None:
            self._learning.reset()

    @property
    def function(self) -> TransformFunction:
        """Return the function of the next cycle."""
        return self._first if self._learning is None else self._learning.in_use

    def state(self) -> ControllerState:
        """Return the state between two cycles."""
        learning = self._learning
        return ControllerState(
            cycle=self._cycle,
            frozen=self._frozen,
            first=self._first,
            second=None if learning is None else learning.second,
            in_use="first" if self.function is self._first else "second",
            points=self._path.nearest(self._first.s_m) if learning is None else learning.points,
            margin=self._margin,
            lead_s=self._lead_s,
        )


#: Twice the damping at which a chain of 1.6e5 N/m, 3.6e3 Nm/rad with a loop time of 35 ms oscillates.
DEFAULT_GAINS = Gains(damping=(7.2e3, 160.0))
#: Twice the damping [s] at which a distance loop of 35 ms oscillates.
DISTANCE_GAINS = Gains(damping=(0.045, 0.045))
FORCE_POINTS = Selection(features=(Feature("force", 10.0),), gain_n=3.0, apart_m=0.002)

First = Literal["fixed", "taught", "speed_table", "exact"]
Hands = Literal["none", "slave", "master", "both"]


@dataclass(frozen=True, slots=True)
class Embodiment:
    """One configuration of the pair.

    Attributes
    ----------
    name, text : for tables
    first : what first function it needs: one fixed relation, taught points, stored speeds, or the simulator's truth
    corrects : which hands yield to force
    gains : impedance of a yielding hand; doubled by the controller when both yield
    dead_band : (force [N], moment [Nm]) that is not corrected
    sensing : "force", or "distance" (then `[m]`, `[rad]` replace `[N]`, `[Nm]`, and damping is in s)
    learning : None = the first function stays
    points : learning points of the first function
    """

    name: str
    text: str
    first: First = "taught"
    corrects: Hands = "slave"
    gains: Gains = DEFAULT_GAINS
    dead_band: tuple[float, float] = (0.0, 0.0)
    sensing: Literal["force", "distance"] = "force"
    learning: LearningRule | None = None
    points: int = 9


_UNIFORM = LearningRule(cycles=3)
_ROWS = (
    Embodiment("A", "one fixed relation", first="fixed", corrects="none"),
    Embodiment("B", "one fixed relation, impedance", first="fixed"),
    Embodiment("C1", "E1: taught function", corrects="none"),
    Embodiment("C1i", "E1 with E4: taught function, impedance"),
    Embodiment(
        "C2m", "E2: learned each cycle from measured positions", learning=LearningRule(source="measured", lead_s=0.0)
    ),
    Embodiment("C2c", "E2: learned each cycle from commands", learning=LearningRule()),
    Embodiment("C3", "E3: function interpolated between learned speeds", first="speed_table"),
    Embodiment(
        "E5",
        "E5: gap kept by distance sensors",
        first="fixed",
        sensing="distance",
        gains=DISTANCE_GAINS,
        # a gap is measured directly: its correction does not depend on a stiffness
        learning=LearningRule(left_share=1.0),
        points=100,
    ),
    Embodiment(
        "C6",
        "E6: learned each cycle, with forgetting",
        learning=LearningRule(forgetting=Forgetting(gamma=0.05, phi=0.6)),
    ),
    Embodiment("C7", "E7: representative of 3 cycles", learning=_UNIFORM),
    Embodiment(
        "C8", "E8: learning points where force acts", learning=replace(_UNIFORM, cycles=2, selection=FORCE_POINTS)
    ),
    Embodiment("C8u", "as C8, points spread evenly", learning=_UNIFORM, points=20),
    Embodiment(
        "C8r",
        "E8 as printed: points replaced",
        learning=replace(_UNIFORM, selection=replace(FORCE_POINTS, keep="replace")),
    ),
    Embodiment("O", "exact relation at every command", first="exact", corrects="none"),
)
EMBODIMENTS: Mapping[str, Embodiment] = {row.name: row for row in _ROWS}


def with_gains(embodiment: Embodiment, gains: Gains) -> Embodiment:
    """Return a copy of the embodiment with another impedance."""
    return replace(embodiment, gains=gains)
