"""Observe the traffic between drives and another master in listen-only mode; nothing is sent.

TPDOs are decoded with the mapping of this gateway (`drives.pdo`). The constants for scaling raw words are taken from
SDO answers of a drive to its master (CiA 301, 7.2.4.3: expedited uploads).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from typing import Final

from drives.bus import EMCY_BASE, SDO_ANSWER_BASE, SYNC_ID, Bus
from drives.emcy import Emergency, parse_emergency
from drives.epoch import Epoch
from drives.errors import ConfigurationRefused
from drives.objects import SIZE_BYTES, decode_integer
from drives.pdo import COMMAND, rpdo_plans, tpdo_plans
from drives.profile import ObjectReference
from drives.scaling import Constants, Decoder, MotorScale, motor_scale, read_constants, reading_decoder
from drives.sdo import COMMAND_BITS, EXPEDITED, SCS_UPLOAD, expedited_data
from drives.values import AxisSetup, DriveReading

#: Emergency messages that wait to be taken.
_KEPT: Final = 64


class _ObservedDrive:
    """One observed drive; its recorded SDO answers are the source of its constants."""

    def __init__(self, setup: AxisSetup, constants: Constants | None) -> None:
        self.setup, self.profile = setup, setup.profile
        self.plans, _ = tpdo_plans(setup.profile, setup.node_id)
        self.frames: list[bytes | bytearray | None] = [None] * len(self.plans)
        self.target_count: int | None = None
        self.decoder: Decoder | None = None
        self.scale: MotorScale | None = None
        self._answers: dict[tuple[int, int], bytes] = {}
        if constants is not None:
            self._set_constants(constants)

    def _set_constants(self, constants: Constants) -> None:
        self.scale = motor_scale(self.profile, constants, self.setup.torque_constant_nm_per_a)
        self.decoder = reading_decoder(self.setup, self.scale)

    def learn(self, data: bytes | bytearray) -> None:
        """Record an SDO answer, and read the constants from the recorded ones as soon as they are complete."""
        if self.scale is None and len(data) == 8 and data[0] & COMMAND_BITS == SCS_UPLOAD and data[0] & EXPEDITED:
            self._answers[int.from_bytes(data[1:3], "little"), data[3]] = bytes(data)
            with suppress(ConfigurationRefused):
                self._set_constants(read_constants(self.profile, self.recorded, self.setup.node_id))

    def recorded(self, where: ObjectReference) -> int | None:
        """Return the recorded value of an object; None where it was not received."""
        size = SIZE_BYTES[where.type]
        with suppress(KeyError, ValueError):  # not received, or of another length than that of the profile
            data = expedited_data(self._answers[where.index, where.subindex], size)
            return decode_integer(data, size, signed=where.type.startswith("i"))
        return None

    def take(self, sync_index: int) -> DriveReading | None:
        """Return the reading of the last SYNC from the frames received since."""
        reading = None if self.decoder is None else self.decoder(sync_index, self.frames)
        self.frames = [None] * len(self.plans)
        return reading


class ListenOnlyBus:
    """Drives of an arm on a bus with another master.

    Parameters
    ----------
    bus : Bus
        Nothing is sent on it.
    setups : sequence of AxisSetup
    constants : sequence of Constants, optional
        Of the drives, where they are known from elsewhere.

    Attributes
    ----------
    sync_index : int
        SYNCs received.
    emergencies : deque of Emergency
        Queue of received messages; the caller removes them.
    """

    def __init__(self, bus: Bus, setups: Sequence[AxisSetup], constants: Sequence[Constants] | None = None) -> None:
        self.sync_index = 0
        self.emergencies: deque[Emergency] = deque(maxlen=_KEPT)
        known = [None] * len(setups) if constants is None else constants
        self._drives = [_ObservedDrive(setup, each) for setup, each in zip(setups, known, strict=True)]
        self._done: deque[Epoch] = deque(maxlen=1024)
        self._began_s: float | None = None
        self._sent_s = 0.0
        self.bus = bus
        bus.subscribe(SYNC_ID, self._on_sync)
        for drive in self._drives:
            self._listen_to(drive)

    @property
    def unknown(self) -> tuple[int, ...]:
        """Return the nodes whose constants were not received, so that their raw values cannot be scaled."""
        return tuple(drive.setup.node_id for drive in self._drives if drive.scale is None)

    def epochs(self) -> list[Epoch]:
        """Return the answered SYNCs since the last call."""
        done = list(self._done)
        self._done.clear()
        return done

    def targets_rad(self) -> list[float | None]:
        """Return the last target position of each drive, motor side; None = not received, or its scale is not known."""
        return [
            None if drive.scale is None or drive.target_count is None else drive.target_count * drive.scale.count_rad
            for drive in self._drives
        ]

    # -- inside --------------------------------------------------------------------------------------------------------

    def _listen_to(self, drive: _ObservedDrive) -> None:
        node_id = drive.setup.node_id

        def on_answer(_can_id: int, data: bytes | bytearray, _time_s: float) -> None:
            drive.learn(data)

        def on_command(_can_id: int, data: bytes | bytearray, _time_s: float) -> None:
            if len(data) >= COMMAND.size:
                drive.target_count = COMMAND.unpack_from(data)[1]

        def on_emergency(_can_id: int, data: bytes | bytearray, _time_s: float) -> None:
            self.emergencies.append(parse_emergency(node_id, bytes(data), self.sync_index, drive.setup.profile))

        for slot, plan in enumerate(drive.plans):

            def on_frame(
                _can_id: int, data: bytes | bytearray, _time_s: float, slot: int = slot, size: int = plan.size_bytes
            ) -> None:
                if len(data) == size:
                    drive.frames[slot] = data

            self.bus.subscribe(plan.cob_id, on_frame)
        self.bus.subscribe(SDO_ANSWER_BASE + node_id, on_answer)
        self.bus.subscribe(rpdo_plans(drive.setup.profile, node_id)[0].cob_id, on_command)
        self.bus.subscribe(EMCY_BASE + node_id, on_emergency)

    def _on_sync(self, _can_id: int, _data: bytes | bytearray, time_s: float) -> None:
        """Assign the frames received since the last SYNC to that SYNC."""
        if self._began_s is None:
            self._began_s = time_s
        else:
            readings = tuple(drive.take(self.sync_index) for drive in self._drives)
            self._done.append(Epoch(self.sync_index, self._sent_s, readings))
        self.sync_index += 1
        self._sent_s = time_s - self._began_s
