"""The drives in a process of their own and the gateway here, on a real SocketCAN."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path

import can
import pytest

from benchmarks.chaos.killing import few_samples
from benchmarks.chaos.processes import Drives, poses
from drives.bus import BusSpec, open_bus
from drives.discovery import probe
from drives.errors import ForeignMaster
from drives.group import DriveGroup, GroupOptions
from gateway.acquire.planning import plan_of_poses
from gateway.acquire.session import record
from gateway.data.recording.reader import read
from gateway.motion import opening
from gateway.motion.opening import axis_setups, open_arm
from sim.faults import fault_of
from tests.support.independent_drives import PATIENCE

#: An emulated processor that others use as well answers with delay; nothing here is about time.
PATIENCE_S = {"answer_timeout_s": 1.0 * PATIENCE, "gap_timeout_s": 0.5 * PATIENCE}
PATIENT = GroupOptions(**PATIENCE_S)

pytestmark = [pytest.mark.vcan, pytest.mark.timeout(900)]


def abbreviated_answers(text: str) -> str:
    """Edit of a cell's text: few SYNCs, since each takes long in a virtual machine."""
    return re.sub(r"approach_offset_rad = [\d.]+", "approach_offset_rad = 0.005", few_samples(text))


@pytest.fixture(scope="module")
def served(vcan: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Drives]:
    folder = tmp_path_factory.mktemp("vcan")
    process = Drives(folder, abbreviated_answers, f"socketcan:{vcan}", patience_s=30.0 * PATIENCE)
    profile = folder / "drive.toml"
    times = f"slow_timeout_s = {PATIENCE}"
    profile.write_text(
        re.sub(r"(?m)^timeout_s = 0.3\nslow_timeout_s = .*$", f"timeout_s = {PATIENCE}\n{times}", profile.read_text())
    )
    yield process
    process.close()


@pytest.fixture
def spec(served: Drives) -> BusSpec:
    served.ask("renew")
    return BusSpec.parse(served.bus)


@contextmanager
def enabled(served: Drives, spec: BusSpec) -> Iterator[DriveGroup]:
    """All six drives of the arm, enabled and holding."""
    setups = axis_setups(served.loaded, served.loaded.cell.arm[0])
    with open_bus(spec) as bus, DriveGroup(bus, setups, 0.02, options=PATIENT) as group:
        group.connect()
        group.configure()
        group.enable()
        yield group


def test_bring_up_and_a_short_recording(
    served: Drives, spec: BusSpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(opening, "GroupOptions", partial(GroupOptions, **PATIENCE_S))
    monkeypatch.setattr("gateway.data.disk.START_TIMEOUT_S", 300.0)  # a process starts slowly under emulation
    path = tmp_path / "run.h5"
    with open_arm(served.loaded, spec, ledger=tmp_path / "ledger.json") as opened:
        plan = plan_of_poses(opened.loaded, opened.config, opened.workspace, poses(2))
        summary = record(opened, plan, "none", path)
    assert summary.visits == 4
    assert summary.statistics["incomplete"] == 0
    taken = {(visit.pose, visit.approach) for visit in read(path).arms[0].visits}
    assert (taken, served.enabled()) == ({(1, -1), (1, 1), (2, -1), (2, 1)}, False)


def test_frames_that_come_back_are_not_another_master(served: Drives, spec: BusSpec) -> None:
    own = BusSpec(spec.interface, spec.channel, spec.bitrate_bit_s, {"receive_own_messages": True})
    with enabled(served, own) as group:
        assert all(group.hold().complete for _ in range(20))
        assert not group.statistics.foreign


def test_answers_in_any_order_make_whole_epochs(served: Drives, spec: BusSpec) -> None:
    with enabled(served, spec) as group:
        served.ask("arm", fault_of("tpdo_reordered", syncs=0, seed=4), 1)
        epochs = [group.hold() for _ in range(15)]
    assert all(epoch.complete for epoch in epochs)
    for epoch in epochs:
        assert [reading.node_id for reading in epoch.readings if reading is not None] == [1, 2, 3, 4, 5, 6]


def test_burst_of_requests_into_a_short_queue(
    served: Drives, spec: BusSpec, short_queue: Callable[[int, int], AbstractContextManager[None]]
) -> None:
    """A scan asks 127 nodes at once; the queue takes four frames: none may be lost, no error may reach the user.

    Whether the queue fills depends on how quickly this machine sends: it is made to drain more slowly until it does.
    """
    retries = 0
    with open_bus(spec) as bus:
        for delay_ms in (4, 8, 16):
            with short_queue(4, delay_ms):
                answers = probe(bus, range(1, 128), timeout_s=0.3 * PATIENCE)
            assert {node for node, number in answers.items() if number} == {1, 2, 3, 4, 5, 6}
            retries = bus.counts["send_retries"]
            if retries:
                break
    assert retries > 0


def test_clock_that_is_set_back_changes_nothing(served: Drives, spec: BusSpec) -> None:
    """Kernel timestamps step with the wall clock; the rows of a run must not."""
    if os.environ.get("SERVO_GATEWAY_IN_VM") != "1":
        pytest.skip("only in the virtual machine is the clock ours to set")
    with enabled(served, spec) as group:
        before = [group.hold().time_s for _ in range(10)]
        now_s = time.time()
        time.clock_settime(time.CLOCK_REALTIME, now_s - 3600.0)
        try:
            after = [group.hold() for _ in range(20)]
        finally:
            time.clock_settime(time.CLOCK_REALTIME, now_s)
    times = before + [epoch.time_s for epoch in after]
    assert all(epoch.complete for epoch in after)
    steps = [later - earlier for earlier, later in zip(times, times[1:], strict=False)]
    assert min(steps) > 0
    assert max(steps) < 1.0


def test_second_master_on_the_bus_stops_the_arm(served: Drives, spec: BusSpec) -> None:
    with enabled(served, spec) as group, can.Bus(interface="socketcan", channel=spec.channel) as other:
        for _ in range(4):
            other.send(can.Message(arbitration_id=0x000, data=b"\x01\x7e", is_extended_id=False))
        with pytest.raises(ForeignMaster):
            hold_many(group)
    assert not served.enabled()


def hold_many(group: DriveGroup) -> None:
    """A few dozen SYNCs."""
    for _ in range(40):
        group.hold()
