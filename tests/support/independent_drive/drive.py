"""One CiA 402 drive: object dictionary, state machine, PDO rules, heartbeat consumer, EMCY (CiA 301, CiA 402-2)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from durand import MinimalNode, get_scheduler
from durand.datatypes import DatatypeEnum as Type
from durand.object_dictionary import Array, Record, Variable
from durand.services.nmt import StateEnum
from durand.services.sdo.server import SDODomainAbort

from tests.support.independent_drive.arm import COUNTS_PER_REVOLUTION
from tests.support.independent_drive.network import NodeNetwork, no_size, zero_extended
from tests.support.independent_drive.plant import Arm

I8, I16, I32 = Type.INTEGER8, Type.INTEGER16, Type.INTEGER32
U8, U16, U32 = Type.UNSIGNED8, Type.UNSIGNED16, Type.UNSIGNED32
VENDOR_ID = 0x0000_0D5A
INTERPOLATED_POSITION, CYCLIC_SYNC_POSITION = 7, 8
#: Controlword of interpolated position mode: enable interpolation.
ENABLE_INTERPOLATION = 0x10
INVALID_PDO = 1 << 31
#: Motor speed of one bit of 0x606C: 0.1 rpm; ramps count in it per second.
SPEED_RAD_S = 2.0 * math.pi / 600.0

SWITCH_ON_DISABLED, READY, SWITCHED_ON, ENABLED = "switch on disabled", "ready", "switched on", "enabled"
QUICK_STOP, FAULT_REACTION, FAULT = "quick stop", "fault reaction", "fault"
STATUS = {
    SWITCH_ON_DISABLED: 0x0040,
    READY: 0x0021,
    SWITCHED_ON: 0x0023,
    ENABLED: 0x0027,
    QUICK_STOP: 0x0007,
    FAULT_REACTION: 0x000F,
    FAULT: 0x0008,
}


@dataclass(frozen=True)
class Variant:
    """What one vendor does differently."""

    product: int
    name: bytes
    answer: Callable[[bytes], bytes]
    communication_error: int  # 0x1029:01: 0 = leaves OPERATIONAL, 1 = keeps its NMT state
    quick_stop: int  # 0x605A: 2 = ramp, then SWITCH ON DISABLED; 6 = ramp, then stays
    mode: int = CYCLIC_SYNC_POSITION  # the only one in which it moves


VARIANTS = {
    "zero-extended": Variant(0x0402_0001, b"AXD-40", zero_extended, 0, 2),
    "no-size": Variant(0x0402_0002, b"SVC-8", no_size, 1, 6),
    "interpolated": Variant(0x0402_0003, b"IPD-7", zero_extended, 0, 2, INTERPOLATED_POSITION),
}


class Drive:
    """A drive at one node id, on one axis of the arm."""

    def __init__(self, network: NodeNetwork, node_id: int, arm: Arm, number: int, variant: Variant) -> None:
        self.arm, self.axis, self.variant = arm, arm.axes[number], variant
        self.state = SWITCH_ON_DISABLED
        #: Joint speeds at which quick stops began [rad/s].
        self.stop_speeds: list[float] = []
        self._controlword = self._evaluated = 0
        self._target_is_new = self._interpolates = False
        self._lag_s = 0.0
        self._watched: int | None = None
        self._watch_timer = self._power_timer = self._mode_timer = None
        self._restoring = True
        self.network = network
        self.node = MinimalNode(network, node_id)
        self.od = self.node.object_dictionary
        self._fill(node_id, number)
        self._default_pdos()
        self._on("download", 0x6040, self._set_controlword)
        self._target = (0x60C1, 1) if variant.mode == INTERPOLATED_POSITION else (0x607A, 0)
        self._on("download", self._target[0], self._set_target, self._target[1])
        self._on("download", 0x6060, self._set_mode)
        self._on("validate", 0x6060, self._refuse_mode)
        self._on("validate", 0x60C2, lambda value: None if value else self._abort(0x06090030, 0x60C2, 1), 1)
        for sub in (1, 2):
            self._on("validate", 0x60C2, lambda _value, sub=sub: self._keep_the_period(sub), sub)
        self._on("update", 0x1016, self._watch, 1)
        for pdo in range(4):
            for communication, mapping in ((0x1400 + pdo, 0x1600 + pdo), (0x1800 + pdo, 0x1A00 + pdo)):
                for entry in range(9):
                    self._on("validate", mapping, self._mapping_rule(communication, mapping, entry), entry)
        self._start = {at: self.od.read(*at) for at in self._writable()}
        self._restoring = False
        self.node.nmt.state_callbacks.add(self._nmt_changed)
        self.measure()

    # -- object dictionary -------------------------------------------------------------------------------------------

    def _fill(self, node_id: int, number: int) -> None:
        od, motor, variant = self.od, self.axis.motor, self.variant
        od.write(0x1000, 0, 0x0002_0192)
        for index, text in ((0x1008, variant.name), (0x1009, b"B"), (0x100A, b"2.07")):
            od.write(index, 0, text)
        for sub, value in enumerate((VENDOR_ID, variant.product, 0x0002_0007, 0x2600_0000 + node_id), start=1):
            od.write(0x1018, sub, value)
        od.write(0x1017, 0, 500)
        od[0x2000] = Variable(Type.VISIBLE_STRING, "rw", b"axis")
        od[0x1003] = Array(Variable(U32, "ro", 0), 4)
        od[0x1006] = Variable(U32, "rw", 0)
        od[0x1016] = Array(Variable(U32, "rw", 0), 1)
        od[0x1019] = Variable(U8, "rw", 0)
        od[0x1029] = Array(Variable(U8, "rw", variant.communication_error), 1)
        for index, kind, access, value in (
            (0x6007, I16, "rw", 1),
            (0x603F, U16, "ro", 0),
            (0x6040, U16, "rw", 0),
            (0x6041, U16, "ro", 0),
            (0x605A, I16, "rw", variant.quick_stop),
            (0x605B, I16, "rw", 0),
            (0x605C, I16, "rw", 1),
            (0x605E, I16, "rw", 2),
            (0x6060, I8, "rw", 0),
            (0x6061, I8, "ro", 0),
            (0x6062, I32, "ro", 0),
            (0x6064, I32, "ro", 0),
            (0x6065, U32, "rw", COUNTS_PER_REVOLUTION),
            (0x6066, U16, "rw", 50),
            (0x606C, I32, "ro", 0),
            (0x6072, U16, "rw", 3000),
            (0x6073, U16, "rw", 3000),
            (0x6075, U32, "rw", motor.rated_current_ma),
            (0x6076, U32, "rw", motor.rated_torque_mnm),
            (0x6077, I16, "ro", 0),
            (0x6078, I16, "ro", 0),
            (0x6079, U32, "ro", 48_000),
            (0x607A, I32, "rw", 0),
            (0x607C, I32, "rw", 0),
            (0x607E, U8, "rw", 0),
            (0x6080, U32, "rw", 4000),
            (0x6084, U32, "rw", round(3.0 * abs(motor.ratio) / SPEED_RAD_S)),
            (0x6085, U32, "rw", round(5.0 * abs(motor.ratio) / SPEED_RAD_S)),
            (0x60B0, I32, "rw", 0),
            (0x60B1, I32, "rw", 0),
            (0x60B2, I16, "rw", 0),
            (0x60C0, I16, "rw", 0),
            (0x60F4, I32, "ro", 0),
            (0x60FD, U32, "ro", 0),
            (0x6502, U32, "ro", 1 << variant.mode - 1),
        ):
            od[index] = Variable(kind, access, value)
        for index, entries in (
            (0x607D, ((I32, -(1 << 31)), (I32, (1 << 31) - 1))),
            (0x608F, ((U32, COUNTS_PER_REVOLUTION), (U32, 1))),
            (0x6091, ((U32, 1), (U32, 1))),
            (0x60C1, ((I32, 0),)),
            (0x60C2, ((U8, 1), (I8, -2))),
        ):
            od[index] = Record()
            for sub, (kind, value) in enumerate(entries, start=1):
                od[index][sub] = Variable(kind, "rw", value)

    def _default_pdos(self) -> None:
        """The first RPDO and TPDO come with controlword and statusword, on event, as CiA 402-2 suggests."""
        for pdos, mapping in ((self.node.rpdo, (0x6040, 0)), (self.node.tpdo, (0x6041, 0))):
            for number, pdo in enumerate(pdos):
                pdo.enable = False
                pdo.transmission_type = 255
                pdo.mapping = [mapping] if number == 0 else []
                pdo.enable = number == 0

    def _writable(self) -> list[tuple[int, int]]:
        """Objects of the profile area and of the heartbeats, which a reset sets back."""
        found = [(0x1006, 0), (0x1016, 1), (0x1017, 0), (0x1019, 0), (0x1029, 1)]
        for index, thing in self.od:
            if index >= 0x6000:
                parts = [(0, thing)] if isinstance(thing, Variable) else [part for part in thing if part[0]]
                found += [(index, sub) for sub, variable in parts if variable.writable]
        return found

    def _on(self, kind: str, index: int, action: Callable, sub: int = 0) -> None:
        getattr(self.od, f"{kind}_callbacks")[(index, sub)].add(action)

    @staticmethod
    def _abort(code: int, index: int, sub: int = 0) -> None:
        raise SDODomainAbort(code, (index, sub))

    def _mapping_rule(self, communication: int, mapping: int, entry: int) -> Callable[[int], None]:
        """A mapping changes only while its PDO is off, entries only while their number is 0 (CiA 301 7.5.2.36)."""

        def validate(value: int) -> None:
            if self._restoring:
                return
            if not self.od.read(communication, 1) & INVALID_PDO or (entry and self.od.read(mapping, 0)):
                self._abort(0x08000022, mapping, entry)
            if entry:
                self._size_of(value, mapping, entry)
                return
            bits = sum(self._size_of(self.od.read(mapping, at), mapping, at) for at in range(1, value + 1))
            if bits > 64:
                self._abort(0x06040042, mapping)

        return validate

    def _size_of(self, entry: int, mapping: int, sub: int) -> int:
        """Bits of a mapped object that exists with just this length."""
        try:
            variable = self.od.lookup(entry >> 16, entry >> 8 & 0xFF)
        except KeyError:
            variable = None
        if not isinstance(variable, Variable) or 8 * (variable.size or 0) != entry & 0xFF:
            self._abort(0x06040041, mapping, sub)
        return entry & 0xFF

    # -- communication -----------------------------------------------------------------------------------------------

    def _nmt_changed(self, state: StateEnum) -> None:
        if state in (StateEnum.STOPPED, StateEnum.INITIALISATION):
            self._abort_connection()
        if state == StateEnum.INITIALISATION:
            self._restoring = True
            for at, value in self._start.items():
                self.od.write(*at, value)
            self._default_pdos()
            self._restoring = False
            self._mode_shows(self.od.read(0x6060, 0))

    def _watch(self, value: int) -> None:
        """Watch a heartbeat (0x1016); the time counts from the first one that comes."""
        if self._watched is not None:
            self.network.remove_subscription(0x700 + self._watched)
        self._cancel_watch()
        node, time_ms = value >> 16 & 0x7F, value & 0xFFFF
        self._watched = node if node and time_ms else None
        if self._watched is not None:
            self.network.add_subscription(0x700 + node, lambda _id, _data: self._on_message(time_ms / 1000.0))

    def _cancel_watch(self) -> None:
        if self._watch_timer is not None:
            get_scheduler().cancel(self._watch_timer)
            self._watch_timer = None

    def _on_message(self, time_s: float) -> None:
        self._cancel_watch()
        self._watch_timer = get_scheduler().add(time_s, self._heartbeat_lost)

    def _heartbeat_lost(self) -> None:
        self._watch_timer = None
        self._emergency(0x8130, 0x11, bytes([self._watched or 0]))
        self._abort_connection()
        if self.od.read(0x1029, 1) == 0 and self.node.nmt.state == StateEnum.OPERATIONAL:
            self.node.nmt.set_state(StateEnum.PRE_OPERATIONAL)

    def _abort_connection(self) -> None:
        """0x6007: 0 nothing, 1 fault, 2 disable voltage, 3 quick stop."""
        option = self.od.read(0x6007, 0)
        if self.state in (SWITCH_ON_DISABLED, FAULT, FAULT_REACTION) or option == 0:
            return
        if option == 1:
            self._fault(0x8130)
        elif option == 3 and self.state == ENABLED:
            self._enter(QUICK_STOP)
        else:
            self._enter(SWITCH_ON_DISABLED)
        self._show_state()

    def _emergency(self, code: int, register: int, data: bytes = b"") -> None:
        history = [self.od.read(0x1003, sub) for sub in range(1, 4)]
        for sub, value in enumerate((code, *history), start=1):
            self.od.write(0x1003, sub, value)
        self.od.write(0x603F, 0, code)
        self.node.emcy.set(code, register, data)

    # -- mode, targets -----------------------------------------------------------------------------------------------

    def _refuse_mode(self, value: int) -> None:
        if value not in (0, self.variant.mode):
            self._abort(0x06090030, 0x6060)

    def _keep_the_period(self, sub: int) -> None:
        if self._interpolates and not self._restoring:
            self._abort(0x08000022, 0x60C2, sub)

    def _set_mode(self, value: int) -> None:
        if value != self.od.read(0x6061, 0) and self._mode_timer is None:
            self._mode_timer = get_scheduler().add(0.01, self._mode_taken)

    def _mode_taken(self) -> None:
        self._mode_timer = None
        self._mode_shows(self.od.read(0x6060, 0))

    def _mode_shows(self, value: int) -> None:
        self.od.write(0x6061, 0, value)

    def _set_target(self, _value: int) -> None:
        self._target_is_new = True

    @property
    def period_s(self) -> float:
        """Interpolation period, 0x60C2."""
        return self.od.read(0x60C2, 1) * 10.0 ** self.od.read(0x60C2, 2)

    def _follow(self) -> None:
        """The new target, or record of 0x60C1, within one interpolation period, inside 0x607D."""
        target = self.od.read(*self._target)
        low, high = self.od.read(0x607D, 1), self.od.read(0x607D, 2)
        self.axis.go(min(high, max(low, target)), self.period_s, self.arm.time_s)

    # -- state machine -----------------------------------------------------------------------------------------------

    def _set_controlword(self, value: int) -> None:
        self._controlword = value

    def act(self) -> None:
        """Take over controlword and target: after a SYNC that made them effective, or after an SDO or event."""
        word, before = self._controlword, self._evaluated
        self._evaluated = word
        state = self._commanded(word, before)
        if state is not None:
            self._enter(state)
            self._show_state()
        if self.variant.mode == INTERPOLATED_POSITION:
            # Active by bit 4 in OPERATION ENABLED. The buffer holds one record; inactive, the drive moves by none.
            was_active = self._interpolates
            ready = (
                self.state == ENABLED
                and not self.axis.brake_closed
                and self.od.read(0x6061, 0) == INTERPOLATED_POSITION
            )
            self._interpolates = ready and bool(word & ENABLE_INTERPOLATION)
            if self._interpolates and not was_active:
                self.axis.hold()
            if was_active and ready and not self._interpolates:
                self.axis.slow_down(self.od.read(0x6084, 0) * SPEED_RAD_S / abs(self.axis.motor.ratio))
        if self._target_is_new:
            self._target_is_new = False
            if self._operates:
                self._follow()

    @property
    def _operates(self) -> bool:
        """Whether the axis follows its target: statusword bit 12, in interpolated position mode "ip mode active"."""
        if self.state != ENABLED or self.axis.brake_closed:
            return False
        return self._interpolates or self.od.read(0x6061, 0) == CYCLIC_SYNC_POSITION

    def _commanded(self, word: int, before: int) -> str | None:
        """State that a controlword asks for; None = none (CiA 402-2, table of device control commands)."""
        state = self.state
        if state == FAULT:
            return SWITCH_ON_DISABLED if word & ~before & 0x80 else None
        if word & 0x80 or state == FAULT_REACTION:
            return None
        if not word & 0x02:  # disable voltage
            return SWITCH_ON_DISABLED if state != SWITCH_ON_DISABLED else None
        if not word & 0x04:  # quick stop
            return {READY: SWITCH_ON_DISABLED, SWITCHED_ON: SWITCH_ON_DISABLED, ENABLED: QUICK_STOP}.get(state)
        if not word & 0x01:  # shutdown
            return READY if state in (SWITCH_ON_DISABLED, SWITCHED_ON, ENABLED) else None
        if not word & 0x08:  # switch on, disable operation
            return SWITCHED_ON if state in (READY, ENABLED) else None
        if state == QUICK_STOP:  # enable operation; transition 16 needs an option code that stays
            return ENABLED if self.od.read(0x605A, 0) in (5, 6, 7, 8) and self.axis.at_rest else None
        return ENABLED if state in (READY, SWITCHED_ON) else None

    def _enter(self, state: str) -> None:
        left, self.state = self.state, state
        axis = self.axis
        self._cancel_power()
        if state == ENABLED:
            rated_nm = self.od.read(0x6076, 0) / 1000.0
            axis.limit_nm = self.od.read(0x6072, 0) / 1000.0 * rated_nm * abs(axis.motor.ratio)
            axis.powered = True
            axis.hold()
            self._power_timer = get_scheduler().add(0.03, self._open_brake)
        elif state in (QUICK_STOP, FAULT_REACTION):
            self.stop_speeds.append(axis.speed)
            if self.od.read(0x605A if state == QUICK_STOP else 0x605E, 0) == 0:
                self._power_off()
                self.state = SWITCH_ON_DISABLED if state == QUICK_STOP else FAULT
            else:
                axis.slow_down(self.od.read(0x6085, 0) * SPEED_RAD_S / abs(axis.motor.ratio))
        elif state == SWITCHED_ON and left == ENABLED and self.od.read(0x605C, 0) == 1:
            axis.slow_down(self.od.read(0x6084, 0) * SPEED_RAD_S / abs(axis.motor.ratio))
        elif left in (ENABLED, QUICK_STOP, FAULT_REACTION):
            self._power_off()

    def _open_brake(self) -> None:
        self._power_timer = None
        self.axis.hold()
        self.axis.brake_closed = False

    def _power_off(self) -> None:
        """Power off at once; the brake holds a little later, and the axis sinks meanwhile."""
        self._cancel_power()
        self.axis.powered = False
        self._power_timer = get_scheduler().add(self.axis.motor.closing_s, self._close_brake)

    def _brake_then_off(self) -> None:
        """At rest: the brake closes first, then power goes off."""
        self.axis.brake_closed = True
        self.axis.hold()
        self._power_timer = get_scheduler().add(0.03, self._close_brake)

    def _close_brake(self) -> None:
        self._power_timer = None
        self.axis.brake_closed, self.axis.powered = True, False

    def _cancel_power(self) -> None:
        if self._power_timer is not None:
            get_scheduler().cancel(self._power_timer)
            self._power_timer = None
            if not self.axis.powered:
                self.axis.brake_closed = True

    def _fault(self, code: int) -> None:
        self._emergency(code, 0x21)
        self._enter(FAULT_REACTION if self.state in (ENABLED, QUICK_STOP) else FAULT)
        self._show_state()

    def _ramps(self) -> None:
        """End of a stop ramp: what the option code says."""
        axis = self.axis
        if self._power_timer is not None or not axis.powered or not axis.at_rest:
            return
        if self.state == QUICK_STOP and self.od.read(0x605A, 0) in (1, 2, 3, 4):
            self._brake_then_off()
            self.state = SWITCH_ON_DISABLED
        elif self.state == FAULT_REACTION:
            self._brake_then_off()
            self.state = FAULT
        elif self.state == SWITCHED_ON and not axis.brake_closed:
            self._brake_then_off()

    def _following(self) -> None:
        """Following error beyond 0x6065 for longer than 0x6066 is a fault."""
        axis, error = self.axis, self.od.read(0x60F4, 0)
        if self.state != ENABLED or axis.brake_closed or abs(error) <= self.od.read(0x6065, 0):
            self._lag_s = 0.0
            return
        self._lag_s += 0.01
        if self._lag_s * 1000.0 > self.od.read(0x6066, 0):
            self._lag_s = 0.0
            self._fault(0x8611)

    # -- actual values -----------------------------------------------------------------------------------------------

    def _show_state(self) -> None:
        word = STATUS[self.state] | 0x0210
        if self.state not in (QUICK_STOP, FAULT, FAULT_REACTION, SWITCH_ON_DISABLED):
            word |= 0x0020
        if self.axis.limited:
            word |= 0x0800
        if self._operates:
            word |= 0x1000
        self.od.write(0x6041, 0, word)

    def measure(self) -> None:
        """Write the actual values: what a SYNC samples, and what SDO reads."""
        axis, write = self.axis, self.od.write
        self._ramps()
        count = axis.count
        demand = round((axis.reference - axis.motor.zero_rad) * axis.counts_per_rad)
        write(0x6064, 0, count)
        if axis.powered:
            permille = axis.motor_nm * 1e6 / self.od.read(0x6076, 0) + self.arm.noise()
            word = max(-32768, min(32767, round(permille)))
            write(0x6077, 0, word)
            write(0x6078, 0, word)
            write(0x60F4, 0, demand - count)
            self._following()
        else:
            write(0x6077, 0, 0)
            write(0x6078, 0, 0)
        write(0x6062, 0, demand)
        write(0x606C, 0, round(axis.motor_rad_s / SPEED_RAD_S))
        self._show_state()
