"""One CiA 402 drive on CANopen: identification, configuration, and the PDO frames of its setpoints and readings."""

from __future__ import annotations

import time
from typing import Final

from drives import drive_limits
from drives.access import ObjectAccess
from drives.bus import Bus
from drives.cia402 import ENABLE_OPERATION, FAULTED, FOLLOWING, RESET, Mode, State, decode_state, describe
from drives.errors import (
    CommandRefused,
    ConfigurationRefused,
    DriveError,
    DriveFault,
    IdentityMismatch,
)
from drives.heartbeat import MASTER_NODE_ID, SIGNS_IN_TIME, rounded_time
from drives.ledger import WriteLedger
from drives.objects import OBJECTS
from drives.other_pdos import OtherPdo
from drives.pdo import COMMAND, TORQUE, VELOCITY, PdoPlan, rpdo_plans, tpdo_plans
from drives.scaling import Constants, MotorScale, motor_scale
from drives.sdo import NORMAL, ONCE, Transfer
from drives.values import AxisSetup, DriveCommand, DriveReading, Identity

__all__ = ["AxisSetup", "Cia402Drive", "DriveCommand", "DriveReading", "Identity"]

#: Time between two readings of what a drive takes a moment to do.
POLL_S: Final = 0.005
_I16_MAX: Final = 0x7FFF
#: An axis that is held outside its limits stays held where a target leads further out by no more than this: a path
#: inwards begins at the position that was read, which is not to the count the one that is held.
POSITION_TOLERANCE_REVOLUTIONS: Final = 1e-3


class Cia402Drive:
    """Master's representation of one CiA 402 drive on CANopen.

    Parameters
    ----------
    bus : Bus
    setup : AxisSetup
    ledger : WriteLedger
        Where every write is entered before it happens.
    """

    def __init__(self, bus: Bus, setup: AxisSetup, ledger: WriteLedger) -> None:
        self.setup = setup
        self.node_id = setup.node_id
        self.access = ObjectAccess(bus, setup.node_id, setup.profile, ledger)
        #: As bring-up read it.
        self.identity = Identity(setup.node_id)
        #: Last position that was commanded.
        self.target_count = 0
        #: PDOs that are switched on and not of the exchange, as bring-up found them.
        self.other_pdos: tuple[OtherPdo, ...] = ()
        #: Those of them that stay on, as far as it is known.
        self.left_pdos: tuple[OtherPdo, ...] = ()
        self._bus = bus
        self._scale: MotorScale | None = None
        #: PDO configurations of the cyclic exchange: what is sent, and what is answered.
        self.commands = rpdo_plans(setup.profile, self.node_id, setup.offsets)
        #: In which it takes the setpoints.
        self.mode = Mode(setup.profile.state_machine.cyclic_mode)
        self._tpdos, _ = tpdo_plans(setup.profile, self.node_id)
        #: RPDOs of the stored target, after `pack`.
        self.frames = tuple(bus.prepare(plan.cob_id, plan.size_bytes) for plan in self.commands)
        #: Time without a sign of the master after which the drive stops, as it was read back.
        self.loss_time_s = 0.0
        self._held_count = 0
        self._staged = (0, 0, 0)
        self.sync_period_s = 0.0
        #: Position at which the axis came to rest when it was last disabled [counts].
        self.rest_count: int | None = None
        self._max_step_count = 0.0
        #: Lowest and highest target [counts].
        self.limit_count = drive_limits.limits_in_counts(None, 1.0)

    @property
    def scale(self) -> MotorScale:
        """Return the factors between raw object values and SI units.

        Raises
        ------
        ConfigurationRefused
            The drive has not been configured.
        """
        if self._scale is None:
            raise ConfigurationRefused("is not configured", node=self.node_id, advice="call configure() first")
        return self._scale

    @property
    def plans(self) -> tuple[PdoPlan, ...]:
        """Return the PDO configurations of the cyclic exchange, RPDO1 first."""
        return (*self.commands, *self._tpdos)

    @property
    def answers(self) -> tuple[tuple[int, int], ...]:
        """Return CAN id and length of each TPDO that follows a SYNC."""
        return tuple((plan.cob_id, plan.size_bytes) for plan in self._tpdos)

    # -- bringing up -------------------------------------------------------------------------------------------------

    def check_identity(self) -> None:
        """Compare the identity of the device with the profile.

        Raises
        ------
        IdentityMismatch
            Vendor, product, firmware or device type differ; one error lists all differences.
        """
        mismatches = self.identity.mismatches(self.setup.profile)
        problems = [*mismatches.values()]
        if self.identity.device_type is not None and not self.identity.is_drive:
            problems.append(f"device type {self.identity.device_type:#010x} is not a CiA 402 drive")
        if problems:
            raise IdentityMismatch(
                f"{'; '.join(problems)} (profile {self.setup.profile.name})",
                node=self.node_id,
                index=0x1018,
                subindex=next(iter(mismatches), 1),
                advice="check wiring and node ids, or choose the profile of this drive and firmware",
            )

    def set_scale(self, constants: Constants, sync_period_s: float) -> None:
        """Set factors and limits of the setpoints from the constants of the drive; raises `ProfileError`.

        Parameters
        ----------
        constants : Constants
        sync_period_s : float
            The speed limit is one of steps of this length.
        """
        self._scale = scale = motor_scale(self.setup.profile, constants, self.setup.torque_constant_nm_per_a)
        self.sync_period_s = sync_period_s
        self.limit_count = drive_limits.limits_in_counts(self.setup.position_limit_rad, scale.count_rad)
        self._max_step_count = self.setup.max_motor_speed_rad_s * sync_period_s / scale.count_rad + 1.0

    def safety_faults(self) -> list[str]:
        """Return the profile's conditions for motion that do not hold now, as text; empty = all hold.

        Emergency stop, safe torque off, and whether the encoder is referenced, as far as the profile names the objects.
        """
        values = [(each, self.access.read(each.object)) for each in self.setup.profile.conditions]
        return [f"{each.what}: {each.describe(value)}" for each, value in values if not each.holds(value)]

    def arm(self) -> None:
        """Make the drive watch the master, from its first heartbeat (0x1016) or node guarding request (0x100C) on."""
        reason, heartbeat = "the drive stops when the master is lost", self.setup.profile.heartbeat
        if heartbeat.watchdog == "heartbeat":
            entry, value = OBJECTS["consumer_heartbeat"], MASTER_NODE_ID << 16 | heartbeat.consumer_ms
            back = self.access.write(entry, value, reason, rounded=rounded_time(value, heartbeat.consumer_ms))
            self.loss_time_s = (back & 0xFFFF) / 1000.0
        else:
            entry, value = OBJECTS["guard_time"], heartbeat.consumer_ms // SIGNS_IN_TIME
            back = self.access.write(entry, value, reason, rounded=rounded_time(value, value))
            self.loss_time_s = back * SIGNS_IN_TIME / 1000.0
            self.access.write(OBJECTS["life_time_factor"], SIGNS_IN_TIME, reason)

    def disarm(self) -> None:
        """End the drive's monitoring of the master."""
        is_guarded = self.setup.profile.heartbeat.watchdog == "node guarding"
        for name in ("guard_time", "life_time_factor") if is_guarded else ("consumer_heartbeat",):
            self.access.write(OBJECTS[name], 0, "the drive no longer watches the master")

    def statusword(self) -> int:
        """Read the statusword by SDO."""
        return self.access.read(OBJECTS["statusword"])

    def read_axis(self, options: Transfer = NORMAL, *, velocity: bool = False) -> tuple[int, int, int | None]:
        """Read statusword, position [counts] and, on request, velocity as the drive reports it, by SDO.

        The velocity is None where it was not requested, where the profile states no unit for it, or where the drive
        refuses it.

        Raises
        ------
        SdoError
            Statusword or position cannot be read.
        """
        profile, read = self.setup.profile, self.access.read
        status, count = read(OBJECTS["statusword"], options), read(profile.position.object, options)
        if not velocity or profile.velocity is None:
            return status, count, None
        return status, count, self.access.read_readable(profile.velocity.object, options)

    def send_controlword(self, controlword: int) -> None:
        """Write the controlword by SDO, where the cycle does not send it: see `pack`."""
        control = OBJECTS["controlword"]
        self.access.sdo.write(*control.address, control.type, controlword)

    def fault_text(self) -> str:
        """Return error code 0x603F with its meaning, or that it cannot be read."""
        try:
            code = self.access.read(OBJECTS["error_code"], ONCE)
        except DriveError:
            return "its error code cannot be read"
        entry = self.setup.profile.emcy_entry(code)
        known = "" if entry is None else f", {entry.text}; {entry.advice}"
        return f"error code 0x{code:04X}{known}"

    def reset_fault(self) -> None:
        """Reset a fault by SDO at the request of a person.

        The drive has the transition time of its profile to leave FAULT.

        Raises
        ------
        DriveFault
            The drive is still in FAULT.
        """
        if decode_state(self.statusword()) is State.FAULT:
            for word in RESET:
                self.send_controlword(word)
        deadline_s = time.monotonic() + self.setup.profile.state_machine.transition_timeout_s
        while decode_state(status := self.statusword()) in FAULTED and time.monotonic() < deadline_s:
            self._bus.listen(POLL_S)
        if decode_state(status) in FAULTED:
            what = f"is still in {describe(status)}: {self.fault_text()}"
            advice = "the cause of the fault is still present"
            raise DriveFault(what, node=self.node_id, index=0x6041, code=status, advice=advice)

    # -- cyclic ------------------------------------------------------------------------------------------------------

    def stage(self, command: DriveCommand) -> None:
        """Check a target and store it for the next RPDO; nothing is sent.

        Raises
        ------
        CommandRefused
            Outside position, speed or torque limits, or not a number.
        """
        scale = self._scale or self.scale
        try:
            count = round(command.position_rad / scale.count_rad)
            velocity = self._velocity(command.velocity_offset_rad_s) if command.velocity_offset_rad_s else 0
            offset = self._torque(command.torque_offset_nm) if command.torque_offset_nm else 0
        except (ValueError, OverflowError) as error:
            raise CommandRefused(f"{command} is not a valid target: {error}", node=self.node_id) from error
        lowest, highest = self.limit_count
        if not lowest <= count <= highest:
            count = self._not_further_out(count)
        step = count - self.target_count
        if not -self._max_step_count <= step <= self._max_step_count:
            what = f"target requires {abs(step) * scale.count_rad / self.sync_period_s:.1f} rad/s"
            advice = f"the limit is {self.setup.max_motor_speed_rad_s:.1f} rad/s at the motor"
            raise CommandRefused(what, node=self.node_id, index=self.setup.profile.target_position.index, advice=advice)
        self._staged = (count, velocity, offset)

    def _not_further_out(self, count: int) -> int:
        """Return a target outside the limits, or the present setpoint where an axis that is held there stays there.

        Raises
        ------
        CommandRefused
            The target is further out than the present setpoint.
        """
        before, (lowest, highest) = self.target_count, self.limit_count
        if highest < count <= before or before <= count < lowest:
            return count
        is_outside = before > highest if count > highest else before < lowest
        tolerance_count = abs(self.scale.revolutions(POSITION_TOLERANCE_REVOLUTIONS))
        if is_outside and before == self._held_count and abs(count - before) <= tolerance_count:
            return before
        what = f"target {count} counts is outside {lowest} .. {highest}"
        advice = "stay inside the limits of the axis; from outside it moves only inwards"
        raise CommandRefused(what, node=self.node_id, index=self.setup.profile.target_position.index, advice=advice)

    def _velocity(self, velocity_rad_s: float) -> int:
        unit = self.scale.velocity_rad_s
        if "velocity" not in self.setup.offsets or unit is None:
            advice = "set the drive up with feedforward"
            raise CommandRefused(
                "is not configured for a velocity offset", node=self.node_id, index=0x60B1, advice=advice
            )
        if abs(velocity_rad_s) > self.setup.max_motor_speed_rad_s:
            what = f"velocity offset of {velocity_rad_s:.1f} rad/s"
            advice = f"the limit is {self.setup.max_motor_speed_rad_s:.1f} rad/s at the motor"
            raise CommandRefused(what, node=self.node_id, index=0x60B1, advice=advice)
        return round(velocity_rad_s / unit)

    def _torque(self, torque_nm: float) -> int:
        unit = self.scale.offset_nm
        if "torque" not in self.setup.offsets or unit is None:
            advice = "set the drive up with a torque offset, and state the scaling of 0x60B2 in its profile"
            raise CommandRefused(
                "is not configured for a torque offset", node=self.node_id, index=0x60B2, advice=advice
            )
        offset = round(torque_nm / unit)
        if abs(offset) > _I16_MAX:
            what = f"torque offset {torque_nm:.3f} Nm does not fit 0x60B2"
            raise CommandRefused(what, node=self.node_id, index=0x60B2, advice="check the feedforward")
        return offset

    def hold(self, position_count: int) -> None:
        """Store a position without offsets for the next RPDO."""
        self._held_count = position_count
        self._staged = (position_count, 0, 0)

    def pack(self, controlword: int, state: State | None = None) -> None:
        """Write the stored target into `frames`; it counts as commanded from now on.

        Offsets are sent only beside the controlword that keeps OPERATION ENABLED; in a drive that is read in that
        state, its bit for following the setpoints is set beside it.
        """
        if controlword != ENABLE_OPERATION:
            self._staged = (self._staged[0], 0, 0)
        elif state is State.OPERATION_ENABLED:
            controlword |= FOLLOWING[self.mode]
        count, velocity, torque = self._staged
        self.target_count = count
        COMMAND.pack_into(self.frames[0].data, 0, controlword, count)
        if "torque" in self.setup.offsets:
            TORQUE.pack_into(self.frames[0].data, COMMAND.size, torque)
        if "velocity" in self.setup.offsets:
            VELOCITY.pack_into(self.frames[1].data, 0, velocity)
