"""Events of a measurement run, sent to console, recording and log."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from gateway.motion.state import CellState


@dataclass(frozen=True, slots=True)
class Started:
    """Event: a recording begins."""

    arm: str
    load: str
    visits: int
    duration_s: float


@dataclass(frozen=True, slots=True)
class Progress:
    """Event: progress of the run; times are planned motion times of the arm."""

    step: int
    steps: int
    what: str
    elapsed_s: float
    remaining_s: float


@dataclass(frozen=True, slots=True)
class SampleRepeated:
    """Event: some axes (numbered from 1) did not answer a SYNC while sampling; the sample is taken again."""

    sync_index: int
    axes: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class VisitDone:
    """Event: a pose is measured from one approach direction and stored on disk.

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
    """Event: a pose is measured from both approach directions.

    Attributes
    ----------
    gravity_nm, friction_band_nm : tuples of floats, one per axis
        Half-sum and half-difference of the torques of both approach directions, each corrected by its gear efficiency.
    """

    pose: int
    load: str
    gravity_nm: tuple[float, ...]
    friction_band_nm: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class PeriodDone:
    """Event: one period of an excitation trajectory is driven and stored on disk.

    Attributes
    ----------
    name : str
        Name of the excitation.
    period : int
        Number of the period, from 1.
    speed : float
        Share of the full speed.
    complete : bool
        True if every SYNC of the period was answered.
    incomplete_epochs : int
        SYNCs that were not answered by all axes.
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
    """Event: the load of a measurement with `--until` was estimated again; `text` states its uncertainty."""

    load: str
    poses: int
    text: str


@dataclass(frozen=True, slots=True)
class Stopped:
    """Event: the run was stopped before the end of its plan."""

    reason: str


@dataclass(frozen=True, slots=True)
class StateChanged:
    """Event: the activity of the arm changed, for example from moving to sampling."""

    state: CellState


Event = StateChanged | Started | Progress | SampleRepeated | VisitDone | PoseDone | PeriodDone | Narrowed | Stopped
Listener = Callable[[Event], None]
