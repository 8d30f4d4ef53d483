"""Every fault inside a drive, in lockstep and in real time: what it does to an axis that is enabled and moves."""

from __future__ import annotations

import time
import uuid
from collections.abc import Callable

import can
import numpy as np
import pytest

from sim.fake_drive import FakeDrive
from sim.faults import KINDS, act, fault_of
from sim.node import OPERATIONAL, PRE_OPERATIONAL, STOPPED
from sim.server import ABANDONED_S
from sim.simulation import ServeOptions, Simulation
from sim.states import PdsState
from tests.sim.conftest import SMALL

NODE, PERIOD_S = 2, 0.01
#: Starts of faults that are injected before a master connects.
BEFORE = ("power-up", "between runs")


class Bench:
    """Six enabled drives of which one moves, and what was seen of it since the fault."""

    def __init__(self, pacing: str, kind: str) -> None:
        self.simulation = Simulation(SMALL, ServeOptions(bus=f"virtual:{uuid.uuid4().hex}", pacing=pacing))
        self.server = self.simulation.servers[0]
        self.unit = self.simulation.arms[0]
        self.drive: FakeDrive = self.server.drive(NODE)
        self.words: list[int] = []
        self.speeds: list[float] = []
        self._target = self.drive.position_counts()
        if KINDS[kind].starts in BEFORE:
            act(self.server.drives, fault_of(kind, node=NODE))
        self.enable()
        self.move(20, 0.002)

    def enable(self) -> None:
        for drive in self.server.drives:
            drive.node.boot()
            drive.node.nmt_command(1)
            drive.motion.take_mode(8)
            for word in (0x06, 0x07, 0x0F):
                drive.take_controlword(word)

    def move(self, syncs: int, step_rad: float) -> None:
        """Run some SYNCs, with the axis commanded by so much at each."""
        for _ in range(syncs):
            self._target += round(step_rad * self.drive.motion.counts_per_joint_rad)
            self.drive.motion.take_target(self._target)
            self.unit.sync()
            self.unit.advance(PERIOD_S)
            self.words.append(self.drive.statusword())
            self.speeds.append(self.drive.axis.omega_rad_s)

    @property
    def state(self) -> PdsState:
        return self.drive.automaton.state

    def close(self) -> None:
        self.server.bus.shutdown()
        self.simulation.close()


def at_rest_in_its_brake(bench: Bench) -> bool:
    return not bench.drive.axis.free and bench.speeds[-1] == 0.0


def moves_on(bench: Bench) -> bool:
    return bench.state is PdsState.OPERATION_ENABLED and abs(bench.speeds[-1]) > 0.15


#: Rows by which drives of makes differ: the axis moves as it does in any other drive.
MAKE_ROWS = (
    *("object_absent", "object_read_only", "object_value", "object_range", "object_not_mappable", "object_size"),
    *("object_rounded", "record_short", "status_bits_off", "status_bits_on", "mode_display_late", "warning_emcy"),
    *("mapping_locked", "period_pair", "rpdo_at_once", "position_wraps", "sync_producer", "modes_supported"),
)

Effect = Callable[[Bench], bool]
EFFECTS: dict[str, Effect] = {
    "node_killed": lambda bench: bench.drive.node.unpowered and at_rest_in_its_brake(bench),
    "node_missing": lambda bench: bench.drive.node.unpowered,
    "power_cycle": lambda bench: bench.drive.node.state == PRE_OPERATIONAL and at_rest_in_its_brake(bench),
    "reboot_keeps_all": lambda bench: bench.drive.motion.mode == 8 and at_rest_in_its_brake(bench),
    "reboot_keeps_communication": lambda bench: bench.drive.motion.mode == 0 and at_rest_in_its_brake(bench),
    "reboot_keeps_nothing": lambda bench: bench.drive.motion.mode == 0 and at_rest_in_its_brake(bench),
    "nmt_preoperational": lambda bench: bench.drive.node.state == PRE_OPERATIONAL and at_rest_in_its_brake(bench),
    "nmt_stopped": lambda bench: bench.drive.node.state == STOPPED and at_rest_in_its_brake(bench),
    "drive_fault": lambda bench: bench.state is PdsState.FAULT and at_rest_in_its_brake(bench),
    "fault_at_start": lambda bench: bench.state is PdsState.FAULT and at_rest_in_its_brake(bench),
    "quick_stop": lambda bench: bench.state is PdsState.SWITCH_ON_DISABLED and at_rest_in_its_brake(bench),
    "safe_torque_off": lambda bench: bench.state is PdsState.SWITCH_ON_DISABLED and at_rest_in_its_brake(bench),
    "brake_engaged": lambda bench: not bench.drive.axis.free,
    "never_settles": lambda bench: float(np.ptp(bench.speeds[-60:])) > 0.02,
    "demand_torque": lambda bench: (
        bench.drive.store.entries[bench.drive.units.torque.address].get() == bench.drive.demand_word()
    ),
    "unsigned_torque": lambda bench: int(bench.drive.store.entries[bench.drive.units.torque.address].get()) > 0,
    "heartbeat_ignored": moves_on,
    "wrong_rated": lambda bench: bench.drive.store.number((0x6076, 0)) > 1_000_000,
    "rated_zero": lambda bench: bench.drive.store.number((0x6076, 0)) == 0,
    "write_ignored": lambda bench: (
        bench.drive.store.write(0x6007, 0, (3).to_bytes(2, "little")) is None
        and bench.drive.store.number((0x6007, 0)) == 1
    ),
    "drive_exchanged": lambda bench: (
        bench.drive.store.number((0x1018, 4)) not in {drive.serial for drive in bench.server.drives}
        and bench.drive.store.number((0x6072, 0)) < bench.server.drive(1).store.number((0x6072, 0))
    ),
    "wrong_vendor": lambda bench: (
        bench.drive.store.number((0x1018, 1)) != bench.server.drive(1).store.number((0x1018, 1))
    ),
    "strict_inhibit": moves_on,
    "start_refused": lambda bench: bench.drive.node.state == PRE_OPERATIONAL,
    "start_never": lambda bench: bench.drive.node.state == PRE_OPERATIONAL,
    "cycle_period_set": lambda bench: bench.drive.node.state == PRE_OPERATIONAL,
    "no_data_abort": moves_on,
    "tpdo3_on": moves_on,
    "foreign_emcy_id": moves_on,
    "emcy_disabled": moves_on,
    "estop_pressed": lambda bench: bench.state is PdsState.SWITCH_ON_DISABLED and at_rest_in_its_brake(bench),
    "unreferenced": moves_on,
    "coasting_stop": moves_on,
    "no_heartbeat": moves_on,
    "never_enables": lambda bench: bench.state is PdsState.SWITCHED_ON and not bench.drive.axis.free,
    "enables_and_drops": lambda bench: bench.state is PdsState.SWITCHED_ON and not bench.drive.axis.free,
    "brake_slips": moves_on,
    "brake_falls": moves_on,
    **{kind: moves_on for kind, about in KINDS.items() if about.reaction == "drive test"},
    "slow_brake": moves_on,
    # three words at once: only the last one is left to act
    "slow_enable": lambda bench: bench.state is PdsState.SWITCH_ON_DISABLED and at_rest_in_its_brake(bench),
    **dict.fromkeys(MAKE_ROWS, moves_on),
    "single_turn": at_rest_in_its_brake,
}


def test_every_kind_inside_a_drive_has_its_effect_stated() -> None:
    inside = {kind for kind, about in KINDS.items() if about.where not in ("wire", "master")}
    assert inside == set(EFFECTS)


@pytest.mark.parametrize("pacing", ["lockstep", "real"])
@pytest.mark.parametrize("kind", EFFECTS)
def test_a_fault_inside_a_drive_does_what_it_says_in_both_pacings(kind: str, pacing: str) -> None:
    bench = Bench(pacing, kind)
    others = [drive for drive in bench.server.drives if drive.node_id != NODE]
    if KINDS[kind].starts not in BEFORE:
        assert moves_on(bench)
        act(bench.server.drives, fault_of(kind, node=NODE))
    if kind == "heartbeat_ignored":
        bench.drive.node.on_heartbeat_lost(127)
    bench.move(40, 0.002)
    done = EFFECTS[kind](bench)
    bench.close()
    assert done
    assert all(drive.enabled and drive.node.state == OPERATIONAL for drive in others)


@pytest.mark.parametrize(
    ("kind", "kept"),
    [
        ("reboot_keeps_all", (250, 1, 8, 500)),
        ("reboot_keeps_communication", (250, 1, 0, 3750)),
        ("reboot_keeps_nothing", (1000, 255, 0, 3750)),
    ],
)
def test_a_reboot_keeps_what_its_kind_says(kind: str, kept: tuple[int, ...]) -> None:
    bench = Bench("lockstep", kind)
    write = bench.drive.store.write
    write(0x1017, 0, (250).to_bytes(2, "little"))
    write(0x1800, 2, b"\x01")
    write(0x6072, 0, (500).to_bytes(2, "little"))
    act(bench.server.drives, fault_of(kind, node=NODE))
    held = [int.from_bytes(bench.drive.store.read(*each), "little") for each in ((0x1017, 0), (0x1800, 2), (0x6072, 0))]
    assert (held[0], held[1], bench.drive.motion.mode, held[2]) == kept
    bench.close()


def test_in_lockstep_drives_stop_by_themselves_once_the_master_is_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench("lockstep", "warning")
    server, now = bench.server, [time.monotonic()]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    for drive in server.drives:
        drive.store.write(0x1016, 1, (127 << 16 | 500).to_bytes(4, "little"))
        drive.node.note_heartbeat(127, bench.unit.world.time_s)
    server.serve(can.Message(arbitration_id=0x77F, data=b"\x05", is_extended_id=False))

    def wait(seconds: float) -> None:
        for _ in range(round(seconds / 0.05)):
            now[0] += 0.05
            server.serve(None)

    wait(ABANDONED_S - 0.5)
    assert all(drive.enabled for drive in server.drives)
    wait(2.0)
    assert not any(drive.automaton.energised for drive in server.drives)
    at_rest_s = bench.unit.world.time_s
    wait(5.0)
    assert bench.unit.world.time_s < at_rest_s + 0.2, "time stops again"
    bench.close()


def test_a_drive_does_not_notice_that_its_brake_falls_in() -> None:
    bench = Bench("lockstep", "brake_engaged")
    act(bench.server.drives, fault_of("brake_engaged", node=NODE))
    bench.move(5, 0.002)
    follows = bench.drive.statusword() & 1 << 12
    bench.close()
    assert follows
