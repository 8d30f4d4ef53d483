"""Events of a run, for console, recording and log."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from gateway.motion.state import CellState


@dataclass(frozen=True, slots=True)
class Started:
    """A recording begins."""

    arm: str
    load: str
    visits: int
    duration_s: float


@dataclass(frozen=True, slots=True)
class Progress:
    """Progress of the run; times are those of the arm, as planned."""

    step: int
    steps: int
    what: str
    elapsed_s: float
    remaining_s: float


@dataclass(frozen=True, slots=True)
class SampleRepeated:
    """A SYNC while sampling that some axes (from 1) left unanswered; it is taken again."""

    sync_index: int
    axes: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class VisitDone:
    """One side of a pose is measured and on disk.

    Attributes
    ----------
    torque_nm, torque_std_nm : tuples of floats, one per axis
        Mean and standard deviation of the joint torque, efficiency not applied.
    """

    number: int
    pose: int
    direction: int
    load: str
    torque_nm: tuple[float, ...]
    torque_std_nm: tuple[float, ...]
    settle_s: float
    incomplete_epochs: int


@dataclass(frozen=True, slots=True)
class PoseDone:
    """Both sides of a pose are measured.

    Attributes
    ----------
    gravity_nm, friction_band_nm : tuples of floats, one per axis
        Half the sum and half the difference of the two sides, each with the gear efficiency of its direction.
    """

    pose: int
    load: str
    gravity_nm: tuple[float, ...]
    friction_band_nm: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class PeriodDone:
    """One period of an excitation is driven and on disk.

    Attributes
    ----------
    name : str
        Of the excitation.
    period : int
        Which of its periods, from 1.
    speed : float
        Share of the full speed.
    complete : bool
        Every SYNC of it was answered.
    incomplete_epochs : int
        SYNCs that were not.
    """

    number: int
    name: str
    period: int
    load: str
    speed: float
    complete: bool
    incomplete_epochs: int


@dataclass(frozen=True, slots=True)
class Narrowed:
    """A load that is measured until it is known well enough was estimated anew; `text` says how far it is known."""

    load: str
    poses: int
    text: str


@dataclass(frozen=True, slots=True)
class Stopped:
    """The run ended before its plan did."""

    reason: str


@dataclass(frozen=True, slots=True)
class StateChanged:
    """The arm does something else now."""

    state: CellState


Event = StateChanged | Started | Progress | SampleRepeated | VisitDone | PoseDone | PeriodDone | Narrowed | Stopped
Listener = Callable[[Event], None]
