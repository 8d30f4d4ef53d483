"""CANopen slave of a simulated drive after CiA 301, an extension of canopen's `LocalNode`.

Kept from the library: SDO segmentation, EMCY framing, association with a network. Own: access to the object store,
refusal of requests that make no sense, NMT slave with boot-up, heartbeat producer and consumer without threads.
"""

from __future__ import annotations

import struct
from collections.abc import Callable

import canopen
from canopen.nmt import NmtSlave
from canopen.sdo.exceptions import SdoAbortedError
from canopen.sdo.server import SdoServer

from sim.objects import DEVICE_STATE, TOGGLE, UNKNOWN_COMMAND, VALUE_RANGE, ObjectStore

INITIALISING, STOPPED, OPERATIONAL, PRE_OPERATIONAL = 0, 4, 5, 127
_COMMANDS = {1: OPERATIONAL, 2: STOPPED, 128: PRE_OPERATIONAL}
RESET_NODE, RESET_COMMUNICATION = 129, 130
START = 1
MAX_HISTORY = 8
#: Bit 31 of 0x1014: the device sends no EMCY.
EMCY_OFF = 1 << 31
#: Object that identifies a simulated node, in the manufacturer-specific range.
SIMULATOR_OBJECT, SIMULATOR_NAME = (0x5FFE, 0), "servo-sim"

SdoFilter = Callable[[int, int], int | None]


class SlaveSdoServer(SdoServer):
    """SDO server: expedited and segmented, one transfer at a time.

    `refuse` is called before each access: an abort code instead of an answer, or None to continue.
    """

    def __init__(self, rx_cobid: int, tx_cobid: int, node: SlaveNode) -> None:
        super().__init__(rx_cobid, tx_cobid, node)
        self._index = self._subindex = 0
        self._transfer = ""
        self.refuse: SdoFilter = lambda _index, _subindex: None

    def on_request(self, can_id: int, data: bytearray, timestamp: float) -> None:
        """Process one request frame of an SDO client."""
        if len(data) != 8 or self._node.unpowered or self._node.state in (STOPPED, INITIALISING):
            return
        kind = data[0] & 0xE0
        if kind in (0x20, 0x40, 0xA0, 0xC0):
            self._index, self._subindex = data[1] | data[2] << 8, data[3]
            refusal = self.refuse(self._index, self._subindex)
            if refusal is not None:
                self.abort(refusal)
                return
            self._transfer = {0x20: "" if data[0] & 0x02 else "down", 0x40: "up", 0xA0: "up"}.get(kind, "")
        elif (kind == 0x60 and self._transfer != "up") or (kind == 0x00 and self._transfer != "down"):
            self.abort(UNKNOWN_COMMAND)
            return
        super().on_request(can_id, data, timestamp)

    def segmented_upload(self, command: int) -> None:
        """Send the next segment; a wrong toggle bit aborts the transfer."""
        if command & 0x10 != self._toggle:
            raise SdoAbortedError(TOGGLE)
        super().segmented_upload(command)
        if not self._buffer:
            self._transfer = ""

    def abort(self, abort_code: int = 0x08000000) -> None:
        """End the transfer."""
        self._transfer = ""
        super().abort(abort_code)

    def request_aborted(self, data: bytearray) -> None:
        """Process an abort by the client."""
        self._transfer = ""
        super().request_aborted(data)


class SlaveNmt(NmtSlave):
    """NMT slave: commands act on the drive, the heartbeat is sent by the time base."""

    def on_command(self, can_id: int, data: bytearray, timestamp: float) -> None:
        """Process an NMT frame of the master."""
        if len(data) >= 2 and data[1] in (0, self.id):
            self._local_node.nmt_command(data[0])

    def start_heartbeat(self, heartbeat_time_ms: int) -> None:
        """Do nothing: `SlaveNode.keep_time` sends the heartbeat without a thread."""


class SlaveNode(canopen.LocalNode):
    """CANopen slave device.

    Attributes
    ----------
    store : its objects
    number : node id
    state : NMT state, 0 initialising, 4 stopped, 5 operational, 127 pre-operational
    unpowered : sends and answers nothing (no power)
    on_nmt : called with (old state, new state)
    on_reset : called when the application is reset
    on_heartbeat_lost : called with the node whose heartbeat stopped, or with the own number where node guarding stopped
    on_heartbeat_resumed : called at the first heartbeat, or request of node guarding, after a loss
    may_start : asked before START is obeyed
    """

    def __init__(self, node_id: int, store: ObjectStore) -> None:
        self.store = store
        self.number = node_id
        self._register()
        super().__init__(node_id, store.dictionary())
        self.sdo = SlaveSdoServer(0x600 + node_id, 0x580 + node_id, self)
        self.nmt = SlaveNmt(node_id, self)
        self.state = INITIALISING
        self.unpowered = False
        self.error_register = 0
        self._history: list[int] = []
        self._beat_s: dict[str, float] = {}
        self._watched_s: dict[int, float] = {}
        self.on_nmt: Callable[[int, int], None] = lambda _old, _new: None
        self.on_reset: Callable[[], None] = lambda: None
        self.on_heartbeat_lost: Callable[[int], None] = lambda _node: None
        self.on_heartbeat_resumed: Callable[[], None] = lambda: None
        self._heartbeat_error = False
        #: Toggle bit of the next answer of node guarding.
        self._toggle = 0
        self.may_start: Callable[[], bool] = lambda: True

    # --------------------------------------------------------------------------------------------- object dictionary

    def _register(self) -> None:
        store = self.store
        store.constant(SIMULATOR_OBJECT, "str", SIMULATOR_NAME)
        store.live((0x1001, 0), "u8", lambda: self.error_register)
        store.live((0x1003, 0), "u8", lambda: len(self._history), self._clear_history)
        for sub in range(1, MAX_HISTORY + 1):
            store.live((0x1003, sub), "u32", self._history_getter(sub))
        store.constant((0x1016, 0), "u8", 1)
        store.parameter((0x1016, 1), "u32", 0, lambda _value: self._watched_s.clear())
        store.parameter((0x1017, 0), "u16", 1000)
        store.parameter((0x100C, 0), "u16", 0)
        store.parameter((0x100D, 0), "u8", 0)
        store.parameter((0x1014, 0), "u32", 0x80 + self.number, self._check_emcy_id)

    def _check_emcy_id(self, value: int) -> None:
        """The identifier is changed only while the EMCY object does not exist (CiA 301, 7.5.2.17)."""
        now = self.store.number((0x1014, 0))
        if not 0x81 <= value & 0x7FF <= 0x7FF:
            raise SdoAbortedError(VALUE_RANGE)
        if not (now | value) & EMCY_OFF and now != value:
            raise SdoAbortedError(DEVICE_STATE)

    def _history_getter(self, sub: int) -> Callable[[], int]:
        return lambda: self._history[sub - 1] if sub <= len(self._history) else 0

    def _clear_history(self, value: int) -> None:
        if value:
            raise SdoAbortedError(VALUE_RANGE)
        self._history.clear()

    def get_data(self, index: int, subindex: int, check_readable: bool = False) -> bytes:
        """Read an object from the object store for an upload."""
        return self.store.read(index, subindex)

    def set_data(self, index: int, subindex: int, data: bytes, check_writable: bool = False) -> None:
        """Write an object to the object store for a download."""
        self.store.write(index, subindex, bytes(data))

    # ----------------------------------------------------------------------------------------------------------- NMT

    def boot(self) -> None:
        """Send the boot-up message after power-up or reset, and enter PRE-OPERATIONAL."""
        self.error_register = 0
        self._heartbeat_error = False
        self._watched_s.clear()
        self._beat_s.clear()
        self._toggle = 0
        self.send(0x700 + self.number, b"\x00")
        self.enter(PRE_OPERATIONAL)

    def nmt_command(self, command: int) -> None:
        """Execute an NMT command of the master."""
        if self.unpowered:
            return
        if command in (RESET_NODE, RESET_COMMUNICATION):
            self.enter(INITIALISING)
            self.on_reset()
            self.boot()
        elif command in _COMMANDS and (command != START or self.may_start()):
            self.enter(_COMMANDS[command])

    def enter(self, state: int) -> None:
        """Enter an NMT state."""
        old, self.state = self.state, state
        if old != state:
            self._beat_s.clear()  # the next heartbeat is due at once
            self.on_nmt(old, state)

    # ----------------------------------------------------------------------------------- heartbeats, node guarding

    def keep_time(self, simulated_s: float, wall_s: float) -> None:
        """Send the heartbeat when it is due in simulated or real time, whichever is first."""
        period = self.store.number((0x1017, 0)) * 1e-3
        if not period or self.state == INITIALISING:
            return
        now = {"simulated": simulated_s, "wall": wall_s}
        if not self._beat_s or any(now[clock] - at >= period for clock, at in self._beat_s.items()):
            self._beat_s = now
            self.send(0x700 + self.number, bytes([self.state]))

    def note_heartbeat(self, node_id: int, time_s: float) -> None:
        """Note a heartbeat of another node; monitoring begins with the first one."""
        if self.store.number((0x1016, 1)) >> 16 == node_id:
            self._alive(node_id, time_s)

    def answer_guarding(self, time_s: float) -> None:
        """Answer a remote frame of node guarding (CiA 301, 7.2.8.3.2.1), which a node with a heartbeat does not."""
        if self.unpowered or self.state == INITIALISING or self.store.number((0x1017, 0)):
            return
        self.send(0x700 + self.number, bytes([self._toggle | self.state]))
        self._toggle ^= 0x80
        self._alive(self.number, time_s)

    def _alive(self, source: int, time_s: float) -> None:
        self._watched_s[source] = time_s
        if self._heartbeat_error:
            self._heartbeat_error = False
            self.on_heartbeat_resumed()

    def watch(self, time_s: float) -> None:
        """Check whether the heartbeat of a monitored node (0x1016) or node guarding (0x100C x 0x100D) stopped."""
        number = self.store.number
        setting = number((0x1016, 1))
        limits_ms = {setting >> 16: setting & 0xFFFF, self.number: number((0x100C, 0)) * number((0x100D, 0))}
        for source, limit_ms in limits_ms.items():
            since = self._watched_s.get(source)
            if limit_ms and since is not None and time_s - since > limit_ms * 1e-3:
                del self._watched_s[source]
                self._heartbeat_error = True
                self.on_heartbeat_lost(source)

    # ---------------------------------------------------------------------------------------------------------- EMCY

    def emergency(self, code: int, register: int) -> None:
        """Send an EMCY and keep it in the history (0x1003)."""
        self.error_register = register
        if code:
            self._history.insert(0, code)
            del self._history[MAX_HISTORY:]
        cob_id = self.store.number((0x1014, 0))
        if self.state in (PRE_OPERATIONAL, OPERATIONAL) and not cob_id & EMCY_OFF:
            self.send(cob_id & 0x7FF, struct.pack("<HB5s", code, register, b""))

    def send(self, cob_id: int, data: bytes) -> None:
        """Send a frame if the device has power."""
        if not self.unpowered:
            self.network.send_message(cob_id, data)
