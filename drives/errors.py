"""Typed errors of the motor side; each carries the exit code of the command line.

DriveError (4)
+-- BusError                adapter, wire, or a frame that could not be sent
|   +-- BusOverload         the planned cycle does not fit the wire
|   +-- BusOff              the controller left the bus
|   +-- ForeignMaster       SYNC, NMT or SDO requests of another master
+-- SdoError
|   +-- SdoAbort            the drive refused, with the abort code in words
|   +-- SdoTimeout          no answer in time (also TimeoutError)
|   +-- SdoProtocolError    an answer for another object, a wrong toggle bit, a wrong length
+-- NodeMissing             nobody answers at this node id
+-- DuplicateNode           more than one device answers at this node id
+-- IdentityMismatch        vendor, product or firmware is not what the profile is for
+-- ConfigurationRefused    a value that was written does not read back, or must not be written
+-- CommandRefused          a target outside the limits; nothing was sent (also ValueError)
+-- DriveFault              FAULT, quick stop or a state that nobody asked for
|   +-- DriveRebooted       boot-up in the middle of a run: its configuration is gone
|   +-- HeartbeatLost       the drive's heartbeat stopped, or never came
+-- NotOperational          a node does not take the NMT command START
+-- StopAsked (130)         a person asked to stop while the drives were being enabled
+-- TransitionTimeout       a CiA 402 transition did not happen in time (also TimeoutError)
+-- IncompleteEpochs        an axis did not answer several SYNCs in a row
+-- ProfileError (3)        a drive profile that cannot be used (also ValueError)
+-- SeveralFailures         every drive's failure at once
"""

from __future__ import annotations

from collections.abc import Sequence

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
        """`node 3:6077:00 (torque)`, as far as it is known."""
        parts = [] if self.node is None else [f"node {self.node}"]
        if self.index is not None:
            parts.append(object_name(self.index, self.subindex or 0))
        return ":".join(parts)

    def __str__(self) -> str:
        text = f"{self.where}: {self.what}" if self.where else self.what
        return (f"{text}; {self.advice}" if self.advice else text) + self._aftermath()

    def _aftermath(self) -> str:
        if not self.while_stopping:
            return ""
        return f"; while stopping: {', '.join(str(error) for error in self.while_stopping)}"


class BusError(DriveError):
    """Adapter, wire, or a frame that could not be sent."""


class BusOverload(BusError):  # noqa: N818 - reads as what happened
    """The planned cycle does not fit the wire."""


class BusOff(BusError):  # noqa: N818 - reads as what happened
    """The CAN controller left the bus."""


class ForeignMaster(BusError):  # noqa: N818 - reads as what happened
    """SYNC, NMT or SDO requests that this master did not send."""


class SdoError(DriveError):
    """An SDO transfer that failed."""


class SdoAbort(SdoError):  # noqa: N818 - reads as what happened
    """The drive refused the transfer; `code` is the CiA 301 abort code."""


class SdoTimeout(SdoError, TimeoutError):  # noqa: N818 - reads as what happened
    """No answer in time."""


class SdoProtocolError(SdoError):
    """An answer that breaks the protocol."""


class NodeMissing(DriveError):  # noqa: N818 - reads as what happened
    """Nobody answers at this node id."""


class DuplicateNode(DriveError):  # noqa: N818 - reads as what happened
    """More than one device answers at this node id."""


class IdentityMismatch(DriveError):  # noqa: N818 - reads as what happened
    """Vendor, product or firmware is not what the profile is for."""


class ConfigurationRefused(DriveError):  # noqa: N818 - reads as what happened
    """A value that does not read back as written, or that must not be written."""


class CommandRefused(DriveError, ValueError):  # noqa: N818 - reads as what happened
    """A target outside the limits; nothing was sent."""


class DriveFault(DriveError):  # noqa: N818 - reads as what happened
    """A drive left OPERATION ENABLED by itself, or is in FAULT; `code` is its statusword."""


class DriveRebooted(DriveFault):
    """Boot-up in the middle of a run: the drive's configuration is gone."""


class HeartbeatLost(DriveFault):
    """The heartbeat of a drive stopped."""


class NotOperational(DriveError):  # noqa: N818 - reads as what happened
    """A node does not go to NMT state OPERATIONAL, however often it is told to."""


class StopAsked(DriveError):  # noqa: N818 - reads as what happened
    """A person asked to stop while the drives were being enabled; all of them have been disabled."""

    exit_code = 130


class TransitionTimeout(DriveError, TimeoutError):  # noqa: N818 - reads as what happened
    """A CiA 402 transition did not happen in time."""


class IncompleteEpochs(DriveError):  # noqa: N818 - reads as what happened
    """An axis did not answer several SYNCs in a row."""


class ProfileError(DriveError, ValueError):
    """A drive profile that cannot be used."""

    exit_code = 3


class SeveralFailures(DriveError):  # noqa: N818 - reads as what happened
    """Every drive's failure at once.

    Attributes
    ----------
    failures : tuple of DriveError
        One or more per drive, in the order of the axes.
    """

    def __init__(self, failures: Sequence[DriveError]) -> None:
        self.failures = tuple(failures)
        super().__init__("; ".join(str(failure) for failure in self.failures))

    def __str__(self) -> str:
        lines = "; ".join(f"({number}) {failure}" for number, failure in enumerate(self.failures, start=1))
        return f"{len(self.failures)} failures: {lines}{self._aftermath()}"


def raise_failures(failures: Sequence[DriveError]) -> None:
    """Raise nothing, the only failure itself, or `SeveralFailures`."""
    if len(failures) == 1:
        raise failures[0]
    if failures:
        raise SeveralFailures(failures)
