"""The pre-flight check holds for every command that opens an arm, and reports stopped nodes and swapped buses."""

from __future__ import annotations

import json
import re
import threading
import uuid
from contextlib import contextmanager

import pytest

from benchmarks.fuzz.check_files import RESULT_SEED
from gateway.cell.config import load_cell
from gateway.model.arm_model import arm_robot
from sim.simulation import ServeOptions, Simulation
from tests.support.follow.rig import EXAMPLES

STOPPED = 4
WRONG = {
    "polarity": ((0x607E, 0), 0xC0, "inverts position"),
    "gear": ((0x6091, 1), 50, "applies a gear ratio"),
    "fault reaction": ((0x605E, 0), 0, "coasts"),
    "ramp": ((0x6085, 0), 1, "more than 1 s is refused"),
}


def set_wrong(drives, name, joint=2):
    address, value, _ = WRONG[name]
    drives.handle.simulation.arms[0].drives[joint - 1].store.values[address] = value


def values(drives):
    return [dict(drive.store.values) for drive in drives.handle.simulation.arms[0].drives]


def refused(done, drives, name):
    """Exit 7, one sentence that names the drive; no SYNC was sent, no drive energised."""
    assert done.exit_code == 7, done.output
    (line,) = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    assert "not moved" in line
    assert "J2 node 2" in line
    assert WRONG[name][2] in line
    assert drives.handle.simulation.servers[0].sync_count == 0
    assert drives.stand_still()


@pytest.mark.parametrize("name", WRONG)
def test_recording_is_refused_before_anything_is_written(place, gateway, serve, name):
    drives = serve()
    set_wrong(drives, name)
    before = values(drives)
    done = gateway("record", place.cell, "--bus", drives.bus, "--load", "none", "-o", place.run, "--yes")
    refused(done, drives, name)
    assert values(drives) == before
    assert not place.run.exists()


def test_following_is_refused(place, gateway, serve):
    drives = serve()
    set_wrong(drives, "polarity")
    loaded = load_cell(place.cell)
    known = place.folder / "load.json"
    known.write_text(
        json.dumps(
            json.loads(RESULT_SEED.replace(b"21.0", b"6.0")) | {"robot": arm_robot(loaded, loaded.cell.arm[0]).name}
        )
    )
    words = ["follow", place.cell, "--path", EXAMPLES / "small" / "path.csv", known]
    done = gateway(*words, "--bus", drives.bus, "--yes")
    refused(done, drives, "polarity")


def test_the_other_findings_are_counted(place, gateway, serve):
    drives = serve()
    for name in WRONG:
        set_wrong(drives, name)
    done = gateway("record", place.cell, "--bus", drives.bus, "--load", "none", "-o", place.run, "--yes")
    assert f"(and {len(WRONG) - 1} more)" in done.stderr


@pytest.mark.slow
def test_a_ramp_that_was_changed_is_proven_again(place, gateway, serve):
    drives = serve()
    words = ["move", place.cell, "--bus", drives.bus, "--yes", "--to"]
    first = gateway(*words, "home")
    assert first.exit_code == 0, first.output
    ramp = drives.handle.simulation.arms[0].drives[4].store.values
    ramp[0x6085, 0] = int(ramp[0x6085, 0]) // 2
    again = gateway(*words, "0.1,-0.2,0.4,0,0.3,0")
    assert again.exit_code == 0, again.output
    assert "every drive stopped by itself" in again.stderr
    third = gateway(*words, "home")
    assert "proven 20" in third.stderr


@pytest.mark.slow
def test_drives_are_given_the_limits_that_the_cell_needs_and_get_theirs_back(place, gateway, serve):
    """J6 needs a fifth of what its drive may give; the drive's own limit comes back by `restore`, without a finding."""
    drives = serve()
    last = drives.handle.simulation.arms[0].drives[5].store.values
    found = int(last[0x6072, 0])
    done = gateway("move", place.cell, "--bus", drives.bus, "--to", "home", "--yes")
    assert done.exit_code == 0, done.output
    assert 0 < int(last[0x6072, 0]) < found / 2
    checked = gateway("check", place.cell, "--bus", drives.bus, "--json", "-")
    assert checked.exit_code == 0, checked.output
    assert not [item for item in json.loads(checked.stdout)["findings"] if item["severity"] == "warn"]
    assert gateway("restore", place.cell, "--bus", drives.bus).exit_code == 0
    assert int(last[0x6072, 0]) == found


# ---------------------------------------------------------------------------------------------------- unreadable

#: Optional objects that only inform, one each drive, with the abort code of a read (CiA 301, table 22).
UNREADABLE = {
    0x605D: 0x08000000,
    0x6066: 0x06010000,
    0x607C: 0x06010001,
    0x607F: 0x06040043,
    0x6080: 0x060A0023,
    0x6073: 0x08000020,
}


def refuse_reading(drive, refused):
    served = drive.node.sdo.refuse
    drive.node.sdo.refuse = lambda index, subindex: refused.get(index) or served(index, subindex)


def test_an_optional_object_that_cannot_be_read_is_reported_and_a_needed_one_refused(place, gateway, serve):
    drives = serve()
    simulated = drives.handle.simulation.arms[0].drives
    for drive, (index, code) in zip(simulated, UNREADABLE.items(), strict=True):
        refuse_reading(drive, {index: code})
    simulated[0].store.parameter((0x6065, 0), "u8", 100)  # shorter than CiA 402 states
    out = place.folder / "check.json"
    done = gateway("check", place.cell, "--bus", drives.bus, "--json", out)
    assert done.exit_code == 0, done.output
    unread = [item for item in json.loads(out.read_text())["findings"] if "not readable" in item["what"]]
    assert {item["severity"] for item in unread} == {"info", "warn"}
    for node, (index, code) in enumerate(UNREADABLE.items(), start=1):
        (item,) = [item for item in unread if f"node {node}:{index:04X}:00" in item["where"]]
        assert f"0x{code:08X}" in item["what"]
    assert any("node 1:6065:00" in item["where"] for item in unread)
    refuse_reading(simulated[3], {0x605E: 0x08000000})
    done = gateway("check", place.cell, "--bus", drives.bus)
    assert done.exit_code == 7
    assert "node 4:605E:00 (fault_reaction_option): cannot be read" in " ".join(done.output.split())


# ------------------------------------------------------------------------------------------------------ who sleeps


def test_a_stopped_node_is_said_to_be_stopped_and_is_woken_by_the_recommended_command(place, gateway, serve):
    drives = serve()
    node = drives.handle.simulation.arms[0].drives[2].node
    node.state = STOPPED
    done = gateway("check", place.cell, "--bus", drives.bus, "--json", place.folder / "check.json")
    assert done.exit_code == 7, done.output
    findings = json.loads((place.folder / "check.json").read_text())["findings"]
    (found,) = [item for item in findings if item["severity"] == "fail"]
    assert found["where"] == "J3 node 3"
    assert "NMT state STOPPED" in found["what"]
    assert "servo-gateway restore" in found["advice"]
    assert node.state == STOPPED, "check writes nothing and wakes no drive"
    assert gateway("restore", place.cell, "--bus", drives.bus).exit_code == 0
    assert gateway("check", place.cell, "--bus", drives.bus).exit_code == 0


# ------------------------------------------------------------------------------------------------------- two buses


@contextmanager
def two_arms(place):
    """The small arm twice, each on a bus of its own."""
    text = place.cell.read_text(encoding="utf-8")
    start, end = text.index("[bus.a]"), text.index("[poses]")
    twin = text[start:end].replace("[bus.a]", "[bus.b]").replace('bus = "a"', 'bus = "b"').replace("43114", "43115")
    place.cell.write_text(text[:end] + twin.replace('name = "main"', 'name = "other"') + text[end:], encoding="utf-8")
    channels = [f"virtual:system-{uuid.uuid4().hex}" for _ in range(2)]
    channels_text = ";".join(f"{name}={channel}" for name, channel in zip("ab", channels, strict=True))
    simulation = Simulation(place.cell, ServeOptions(bus=channels_text))
    thread = threading.Thread(target=simulation.run, name="two-arms")
    thread.start()
    try:
        yield channels_text, channels, simulation
    finally:
        simulation.stop()
        thread.join()
        simulation.close()


@pytest.mark.slow
def test_a_cell_with_two_buses_is_checked_and_recorded_on_other_ones(place, gateway):
    with two_arms(place) as (channels_text, channels, simulation):
        done = gateway("check", place.cell, "--bus", channels_text)
        assert done.exit_code == 0, done.output
        assert "arm main" in done.stdout
        assert "arm other" in done.stdout
        words = ["record", place.cell, "--arm", "other", "--load", "none", "-o", place.run, "--yes", "--bus"]
        done = gateway(*words, channels_text)
        assert done.exit_code == 0, done.output
        assert [arm.name for arm in place.recording().arms] == ["other"]
        assert [server.sync_count > 0 for server in simulation.servers] == [False, True]
        assert gateway("restore", place.cell, "--bus", channels_text).exit_code == 0


@pytest.mark.parametrize("command", ["check", "restore"])
def test_one_spec_for_two_buses_is_refused(place, gateway, command):
    with two_arms(place) as (_, channels, _simulation):
        done = gateway(command, place.cell, "--bus", channels[0])
        assert done.exit_code == 3, done.output
        assert "NAME=SPEC;NAME=SPEC with a, b" in done.stderr


def test_what_was_written_to_one_arm_is_said_where_the_next_refuses_it(place, gateway):
    with two_arms(place) as (channels_text, _, simulation):
        assert gateway("config", "dump", place.cell, "--bus", channels_text).exit_code == 0
        for arm, section, value in (("main", "6066", 40), ("other", "605E", 77)):
            path = place.folder / "dcf" / arm / "2.dcf"
            head, own = path.read_text().split(f"\n[{section}]\n")
            path.write_text(
                f"{head}\n[{section}]\n{re.sub('ParameterValue=.*', f'ParameterValue={value}', own, count=1)}"
            )
        done = gateway("config", "apply", place.cell, "--yes", "--bus", channels_text)
        assert done.exit_code == 4, done.output
        assert "arm main: 1 objects written" in done.stdout
        assert "arm other" not in done.stdout
        assert simulation.arms[0].drives[1].store.number((0x6066, 0)) == 40
