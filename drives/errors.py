"""Typed errors of bus and drives; each carries the exit code of the command line.

DriveError (4)
+-- BusError                adapter, wire, or a frame that could not be sent
|   +-- BusOverload         the planned cycle does not fit the wire
|   +-- BusOff              the controller left the bus
|   +-- ForeignMaster       SYNC, NMT or SDO requests of another master
+-- SdoError
|   +-- SdoAbort            the drive refused, with the meaning of the abort code
|   +-- SdoTimeout          no answer in time (also TimeoutError)
|   +-- SdoProtocolError    an answer for another object, a wrong toggle bit, a wrong length
+-- NodeMissing             no device answers at this node id
+-- DuplicateNode           more than one device answers at this node id
+-- IdentityMismatch        vendor, product or firmware is not what the profile is for
+-- ConfigurationRefused    a value that was written does not read back, or must not be written
+-- CommandRefused          a target outside the limits; nothing was sent (also ValueError)
+-- DriveFault              FAULT, quick stop or a state that was not commanded
|   +-- DriveRebooted       boot-up during a run: its configuration is lost
|   +-- HeartbeatLost       the drive's heartbeat stopped, or never came
+-- NotOperational          a node does not take the NMT command START
+-- StopRequested (130)         a person requested a stop while the drives were being enabled
+-- TransitionTimeout       a CiA 402 transition did not happen in time (also TimeoutError)
+-- IncompleteEpochs        an axis did not answer several SYNCs in a row
+-- MasterStalled           this computer stalled while the axes moved
+-- BrakeDropped            a joint dropped after its drive was disabled
+-- NotStoodDown            the drives are disabled, but a write or a read after that failed
+-- ProfileError (3)        a drive profile that cannot be used (also ValueError)
+-- SeveralFailures         every drive's failure at once
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from drives.objects import object_name


class DriveError(Exception):
    """Base: one paragraph that says what, where (node:object), and what to do.

    Parameters
    ----------
    what : str
        What happened, without the place.
    node, index, subindex : int, optional
        Where.
    code : int, optional
        Abort code, error code or statusword, by the class.
    advice : str
        What to do.
    """

    exit_code = 4

    def __init__(
        self,
        what: str,
        *,
        node: int | None = None,
        index: int | None = None,
        subindex: int | None = None,
        code: int | None = None,
        advice: str = "",
    ) -> None:
        self.what = what
        self.node = node
        self.index = index
        self.subindex = subindex
        self.code = code
        self.advice = advice
        #: What else went wrong while the axes were being stopped because of this.
        self.while_stopping: tuple[DriveError, ...] = ()
        super().__init__(what)

    @property
    def where(self) -> str:
        """Return node and object as text, e.g. `node 3:6077:00 (torque)`, as far as they are known."""
        parts = [] if self.node is None else [f"node {self.node}"]
        if self.index is not None:
            parts.append(object_name(self.index, self.subindex or 0))
        return ":".join(parts)

    def __str__(self) -> str:
        text = f"{self.where}: {self.what}" if self.where else self.what
        return (f"{text}; {self.advice}" if self.advice else text) + _aftermath((self,))


class BusError(DriveError):
    """Adapter, wire, or a frame that could not be sent."""


class BusOverload(BusError):  # noqa: N818 - reads as what happened
    """The planned cycle does not fit the wire."""


class BusOff(BusError):  # noqa: N818 - reads as what happened
    """The CAN controller left the bus."""


class ForeignMaster(BusError):  # noqa: N818 - reads as what happened
    """SYNC, NMT or SDO requests that this master did not send."""


class SdoError(DriveError):
    """An SDO transfer failed."""


class SdoAbort(SdoError):  # noqa: N818 - reads as what happened
    """The drive refused the transfer; `code` is the CiA 301 abort code."""


class SdoTimeout(SdoError, TimeoutError):  # noqa: N818 - reads as what happened
    """No SDO response arrived within the time-out."""


class SdoProtocolError(SdoError):
    """An SDO response violates the protocol."""


class NodeMissing(DriveError):  # noqa: N818 - reads as what happened
    """No device answers at this node id."""


class DuplicateNode(DriveError):  # noqa: N818 - reads as what happened
    """More than one device answers at this node id."""


class IdentityMismatch(DriveError):  # noqa: N818 - reads as what happened
    """Vendor, product or firmware does not match the profile."""


class ConfigurationRefused(DriveError):  # noqa: N818 - reads as what happened
    """A value is not read back as written, or must not be written."""


class CommandRefused(DriveError, ValueError):  # noqa: N818 - reads as what happened
    """A target is outside the limits; nothing was sent."""


class DriveFault(DriveError):  # noqa: N818 - reads as what happened
    """A drive left OPERATION ENABLED by itself, or is in FAULT; `code` is its statusword."""


class DriveRebooted(DriveFault):
    """Boot-up during a run: the drive's configuration is lost."""


class HeartbeatLost(DriveFault):
    """The heartbeat of a drive stopped."""


class NotOperational(DriveError):  # noqa: N818 - reads as what happened
    """A node does not enter NMT state OPERATIONAL in spite of repeated commands, or leaves it while axes are
    enabled.
    """


class StopRequested(DriveError):  # noqa: N818 - reads as what happened
    """A person requested a stop while the drives were being enabled; all of them are disabled again."""

    exit_code = 130


class TransitionTimeout(DriveError, TimeoutError):  # noqa: N818 - reads as what happened
    """A CiA 402 transition did not happen in time."""


class IncompleteEpochs(DriveError):  # noqa: N818 - reads as what happened
    """An axis did not answer several SYNCs in a row."""


class MasterStalled(DriveError):  # noqa: N818 - reads as what happened
    """This computer stalled while the axes moved: the setpoint was overdue and was not sent."""


class BrakeDropped(DriveError):  # noqa: N818 - reads as what happened
    """A joint dropped after its drive was disabled: its brake does not hold."""


class NotStoodDown(DriveError):  # noqa: N818 - reads as what happened
    """Every drive was read as disabled; what follows a stop (heartbeat time, position at rest) failed."""


class ProfileError(DriveError, ValueError):
    """A drive profile that cannot be used; `lines` where its file has several problems."""

    exit_code = 3
    lines: tuple[str, ...] = ()

    @classmethod
    def of(cls, lines: Sequence[str], advice: str) -> ProfileError:
        """Build an error with one line per problem and the remedy after the last."""
        error = cls("; ".join(lines), advice=advice)
        error.lines = (*lines[:-1], f"{lines[-1]}; {advice}")
        return error


class SeveralFailures(DriveError):  # noqa: N818 - reads as what happened
    """Failures of several drives in one error.

    Attributes
    ----------
    failures : tuple of DriveError
        One or more per drive, in the order of the axes.
    """

    def __init__(self, failures: Sequence[DriveError]) -> None:
        self.failures = tuple(failures)
        super().__init__("; ".join(str(failure) for failure in self.failures))

    def __str__(self) -> str:
        first, *others = listed = _listed(self.failures)
        if not others:
            text = first
        else:
            lines = "; ".join(f"({number}) {each}" for number, each in enumerate(_short(listed), start=1))
            text = f"{len(self.failures)} failures: {lines}"
        return text + _aftermath((self, *self.failures))


def raise_failures(failures: Sequence[DriveError]) -> None:
    """Raise `SeveralFailures`, or a single failure itself; return if there is none.

    Of an adapter that is gone each frame is a failure: the first one is raised.
    """
    if len(failures) == 1 or (failures and all(type(failure) in (BusError, BusOff) for failure in failures)):
        raise failures[0]
    if failures:
        raise SeveralFailures(failures)


# -- text that fits a screen ----------------------------------------------------------------------------------------

#: Number of different failures listed in one text; the first is the cause.
_MAX_LISTED: Final = 6
#: Longest text of one list of failures: the advice of all but the first is left out of a longer one.
_LONGEST: Final = 500


def while_stopping(error: Exception, node: int | None = None) -> DriveError:
    """Convert an exception raised while stopping into a failure; the axes concerned are not known to have stopped.

    Parameters
    ----------
    error : Exception
        A `DriveError` is returned as it is.
    node : int, optional
        Whose stop it ended.
    """
    if isinstance(error, DriveError):
        return error
    failure = DriveError(
        f"stopping failed: {type(error).__name__}: {error}", node=node, advice="use the emergency stop and report this"
    )
    failure.__cause__ = error
    return failure


def _flat(errors: Sequence[DriveError]) -> list[DriveError]:
    """Return the single failures in order, those inside `SeveralFailures` included."""
    return [
        each for error in errors for each in (_flat(error.failures) if isinstance(error, SeveralFailures) else [error])
    ]


def _same(error: DriveError) -> tuple[object, ...]:
    """Return the key that is equal for failures that differ only by their node."""
    return (error.what, error.index, error.subindex, error.advice)


def _nodes(numbers: Sequence[int]) -> str:
    """`node 3`, `nodes 1 to 6`, `nodes 1, 2, 5`."""
    ordered = sorted(set(numbers))
    if len(ordered) == 1:
        return f"node {ordered[0]}"
    if len(ordered) > 2 and ordered[-1] - ordered[0] == len(ordered) - 1:
        return f"nodes {ordered[0]} to {ordered[-1]}"
    return f"nodes {', '.join(map(str, ordered))}"


def _listed(errors: Sequence[DriveError]) -> list[str]:
    """Return one text per different failure with all its nodes, in order of appearance; each remedy appears once."""
    groups: dict[tuple[object, ...], list[DriveError]] = {}
    for error in _flat(errors):
        groups.setdefault(_same(error), []).append(error)
    with_remedy: list[str] = []
    without_remedy: list[str] = []
    mentioned: set[str] = set()
    for first, *others in groups.values():
        place = first.where
        if first.node is not None and others:
            named = [error.node for error in (first, *others) if error.node is not None]
            place = _nodes(named) + place.removeprefix(f"node {first.node}")
        text = f"{place}: {first.what}" if place else first.what
        advice = "" if first.advice in mentioned else first.advice
        mentioned.add(first.advice)
        with_remedy.append(f"{text}; {advice}" if advice else text)
        without_remedy.append(text)
    if sum(map(len, with_remedy)) <= _LONGEST:
        return with_remedy
    return [*with_remedy[:1], *without_remedy[1:]]


def _short(listed: list[str]) -> list[str]:
    """Return the first entries of a list and the number of the others."""
    if len(listed) <= _MAX_LISTED:
        return listed
    return [*listed[: _MAX_LISTED - 1], f"and {len(listed) - _MAX_LISTED + 1} more"]


def _aftermath(errors: Sequence[DriveError]) -> str:
    """Return the failures while stopping, without those already listed."""
    said = {(error.node, *_same(error)) for error in _flat(errors)}
    later = _flat([each for error in errors for each in error.while_stopping])
    later += _flat([each for error in later for each in error.while_stopping])
    new = [error for error in later if (error.node, *_same(error)) not in said]
    return f"; while stopping: {', '.join(_short(_listed(new)))}" if new else ""
