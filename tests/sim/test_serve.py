"""Simulations as others start them: on a virtual bus, in a process of their own, with loads, effects and faults."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import tomllib
from pathlib import Path

import can
import numpy as np
import pytest
from click.testing import CliRunner

from drives.profile_file import list_profiles
from sim.__main__ import main as sim_command
from sim.build_errors import with_build_errors
from sim.cellfile import CellFileError
from sim.demo import LOAD_PROMPT, comparison
from sim.demo import main as demo_command
from sim.multicast import QuietMulticastBus
from sim.nominal import plant_of
from sim.serve import command, free_bus, running
from sim.simulation import ServeOptions, Simulation
from tests.sim.conftest import Master

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
SMALL = EXAMPLES / "small" / "cell.toml"


def serve(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "sim", "serve", *words], capture_output=True, text=True, timeout=30, check=False
    )


def test_without_the_physics_it_says_what_to_install(monkeypatch):
    """An installation for use alone has no pybullet."""
    monkeypatch.setitem(sys.modules, "pybullet", None)
    for name in [name for name in sys.modules if name.startswith("sim.")]:
        if name.count(".") == 1:  # the package too has the modules that other tests know again afterwards
            monkeypatch.setattr(name, sys.modules[name])
        monkeypatch.delitem(sys.modules, name)
    done = CliRunner().invoke(sim_command, ["serve", str(SMALL)])
    assert done.exit_code == 3
    assert "pybullet is not installed: pip install 'servo-gateway[sim]'" in done.stderr


def test_a_process_of_its_own_answers_mounts_loads_and_writes_the_truth(tmp_path):
    truth = tmp_path / "truth.json"
    undeclared = tmp_path / "effects.toml"
    undeclared.write_text(
        '[[effect]]\nname = "torque_offset"\njoints = [3]\nparameters = { offset_nm = 2.0 }\n', encoding="utf-8"
    )
    options = {"payload": EXAMPLES / "small" / "payload.toml", "undeclared": undeclared, "truth": truth}
    with running(SMALL, **options) as simulation:
        assert json.loads(truth.read_text(encoding="utf-8")) == {
            "loads": [{"label": "gripper", "mass_kg": 6.0, "com_m": [0.02, 0.01, 0.10]}],
            "effects": [{"name": "torque_offset", "joints": [3], "parameters": {"offset_nm": 2.0}}],
        }
        channel, _, port = simulation.bus.removeprefix("udp_multicast:").partition(",port=")
        master = QuietMulticastBus(channel, port=int(port))
        try:
            master.send(can.Message(arbitration_id=0x603, data=[0x40, 0, 0x10, 0, 0, 0, 0, 0], is_extended_id=False))
            answers = iter(lambda: master.recv(5.0), None)
            answer = next(frame for frame in answers if frame.arbitration_id == 0x583)
            assert bytes(answer.data[:4]) == bytes([0x43, 0x00, 0x10, 0x00])
        finally:
            master.shutdown()
        simulation.mount("load")
        simulation.mount("none")
        with pytest.raises(KeyError, match="known are none, gripper"):
            simulation.mount("anvil")


def torque_words(bus: str, noise_seed: int) -> list[int]:
    """Torque that a drive under power reports at rest."""
    interface, _, place = bus.partition(":")
    channel, _, port = place.partition(",port=")
    with running(SMALL, bus, pacing="lockstep", noise_seed=noise_seed):
        master = Master(channel, interface, **({"port": int(port)} if port else {}))
        with master.bus:
            master.configure(3, 8)
            position = master.enable(3)
            return [master.cycle(3, 0x0F, position)[2] for _ in range(10)]


def test_a_process_of_its_own_has_the_noise_of_the_stated_seed(channel):
    alone = torque_words(free_bus(), 5)
    assert alone == torque_words(f"virtual:{channel}", 5)
    assert alone != torque_words(f"virtual:{channel}-other", 6)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["no-such-cell.toml"], "no-such-cell.toml: cannot be read"),
        ([str(SMALL), "--undeclared", "{bad}"], "bad.toml:4: effect 2: unknown effect"),
        ([str(SMALL), "--fault", "{bad}"], "may only contain [[fault]] tables"),
        ([str(SMALL), "--bus", "nonsense"], "INTERFACE:CHANNEL"),
        ([str(SMALL), "--posture", "0,0,0,0,0,9"], "one angle a joint"),
    ],
)
def test_bad_files_end_in_exit_3_and_one_paragraph(words, message, tmp_path):
    bad = tmp_path / "bad.toml"
    drift = '[[effect]]\nname = "thermal_drift"\njoints = [2]\n'
    bad.write_text(f'{drift}[[effect]]\nname = "gremlins"\n', encoding="utf-8")
    done = serve(*(word.replace("{bad}", str(bad)) for word in words))
    assert done.returncode == 3
    assert message in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert "Traceback" not in done.stderr


def test_an_unknown_interface_ends_in_exit_4():
    done = serve(str(SMALL), "--bus", "no_such_interface:x")
    assert done.returncode == 4
    assert len(done.stderr.strip().splitlines()) == 1


def test_effects_and_seed_exclude_each_other():
    assert serve(str(SMALL), "--seed", "1", "--undeclared", "x").returncode == 2


def test_a_seed_makes_another_arm_of_the_same_drawing(arm_of):
    arm = arm_of("large")
    plant = plant_of(arm)
    first, again, second = (with_build_errors(plant, arm.chain, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.link_com_m, again.link_com_m)
    assert not np.allclose(first.link_mass_kg, second.link_mass_kg)
    share = np.array(
        [with_build_errors(plant, arm.chain, seed).link_mass_kg / plant.link_mass_kg for seed in range(60)]
    )
    assert share.std() == pytest.approx(0.03, rel=0.15)


def test_own_frames_do_not_come_back_others_do():
    channel, _, port = free_bus().removeprefix("udp_multicast:").partition(",port=")
    first, second = (QuietMulticastBus(channel, port=int(port)) for _ in range(2))
    try:
        first.send(can.Message(arbitration_id=0x181, data=b"\x01\x02", is_extended_id=False))
        first.send(can.Message(arbitration_id=0x181, data=b"\x01\x02", is_extended_id=False))
        for _ in range(2):
            frame = second.recv(2.0)
            assert frame is not None
            assert (frame.arbitration_id, bytes(frame.data)) == (0x181, b"\x01\x02")
        second.send(can.Message(arbitration_id=0x80, is_extended_id=False))
        frame = first.recv(2.0)
        assert frame is not None
        assert frame.arbitration_id == 0x80
        assert first.recv(0.0) is None
    finally:
        first.shutdown()
        second.shutdown()


@pytest.mark.parametrize("profile", list_profiles())
def test_every_profile_makes_drives_that_answer(profile, tmp_path, channel, master_on):
    text = SMALL.read_text(encoding="utf-8").replace("generic-cia402", profile)
    (tmp_path / "cell.toml").write_text(text, encoding="utf-8")
    (tmp_path / "robot.urdf").write_bytes((EXAMPLES / "small" / "robot.urdf").read_bytes())
    with running(tmp_path / "cell.toml", f"virtual:{channel}", pacing="lockstep") as simulation:
        master = master_on(channel)
        assert profile.encode() in master.read(3, 0x1008)
        drive = simulation.simulation.servers[0].drive(3)
        csp = master.number(3, 0x6502) >> 7 & 1
        master.write(3, 0x6060, 0, 8 if csp else 7, 1)
        if profile == "nanotec":  # delivered with too small a limit to carry the arm
            master.write(3, 0x6072, 0, 3750, 2)
        word = drive.units.torque
        if profile == "trinamic":  # has no torque
            return
        size = {"i16": 2, "i32": 4}[word.type]
        master.map(3, 0, (0x60410010, 0x60640020), 1)
        master.map(3, 1, (word.address[0] << 16 | word.address[1] << 8 | 8 * size,), 1)
        master.map(3, 0, (0x60400010, 0x607A0020 if csp else 0x60C10120), 1, receive=True)
        master.send(0x000, bytes([1, 3]))
        position = master.number(3, 0x6064, signed=True)
        for command in (0x06, 0x07, 0x0F, *[0x0F if csp else 0x1F] * 250):
            master.send(0x203, command.to_bytes(2, "little") + position.to_bytes(4, "little", signed=True))
            master.send(0x080, b"")
            status = master.wait(0x183)
            raw = int.from_bytes(master.wait(0x283), "little", signed=True)
        assert status[0] & 0x6F == 0x27
        shown = raw / word.bits_per_unit * 100
        noise = simulation.simulation.arms[0].world.plant.reading_noise_nm[2]
        assert shown == pytest.approx(drive.axis.servo.u_nm, abs=5 * noise)
        assert abs(shown) > 20


@pytest.mark.parametrize(
    ("fault", "index", "sub", "expected"),
    [("wrong_vendor", 0x1018, 1, None), ("rated_zero", 0x6076, 0, 0), ("fault_at_start", 0x603F, 0, 0x7305)],
)
def test_faults_of_the_drive_are_there_from_the_start(fault, index, sub, expected, tmp_path, channel, master_on):
    scenario = tmp_path / "fault.toml"
    scenario.write_text(f'[[fault]]\nkind = "{fault}"\nnode = 2\n', encoding="utf-8")
    with running(SMALL, f"virtual:{channel}", fault=(scenario,), pacing="lockstep"):
        master = master_on(channel)
        value, other = master.number(2, index, sub), master.number(1, index, sub)
        assert value != other
        assert expected is None or value == expected


def test_a_missing_node_does_not_respond_and_an_aborted_object_refused(tmp_path, channel, master_on):
    scenario = tmp_path / "fault.toml"
    scenario.write_text(
        '[[fault]]\nkind = "node_missing"\nnode = 2\nsyncs = 0\n'
        '[[fault]]\nkind = "sdo_aborted"\nnode = 3\nindex = 0x6076\nsyncs = 0\n',
        encoding="utf-8",
    )
    with running(SMALL, f"virtual:{channel}", fault=(scenario,), pacing="lockstep"):
        master = master_on(channel)
        master.send(0x602, b"\x40\x00\x10\x00\x00\x00\x00\x00")
        with pytest.raises(AssertionError, match="no frame 0x582"):
            master.wait(0x582, 0.05)
        with pytest.raises(master.Aborted):
            master.number(3, 0x6076)
        assert master.number(3, 0x6075) > 0


def test_an_axis_that_never_settles_keeps_moving(tmp_path, channel, master_on):
    scenario = tmp_path / "fault.toml"
    scenario.write_text('[[fault]]\nkind = "never_settles"\nnode = 3\nsyncs = 0\n', encoding="utf-8")
    with running(SMALL, f"virtual:{channel}", fault=(scenario,), pacing="lockstep"):
        master = master_on(channel)
        master.configure(3, 8)
        position = master.enable(3, 100)
        counts = [master.cycle(3, 0x0F, position)[1] for _ in range(200)]
        assert np.ptp(counts) > 0.002 * 100 * 131072 / (2 * np.pi)


def test_a_node_killed_in_the_run_stops_responding(tmp_path, channel, master_on):
    scenario = tmp_path / "fault.toml"
    scenario.write_text('[[fault]]\nkind = "node_killed"\nnode = 3\nat_sync = 40\nsyncs = 0\n', encoding="utf-8")
    with running(SMALL, f"virtual:{channel}", fault=(scenario,), pacing="lockstep") as simulation:
        master = master_on(channel)
        master.configure(3, 8)
        position = master.enable(3, 20)
        for _ in range(39 - 22):
            master.cycle(3, 0x0F, position)
        master.drain()
        master.sync()
        assert 0x183 not in [frame.arbitration_id for frame in master.drain()]
        assert not simulation.simulation.servers[0].drive(3).axis.free


def test_real_pacing_follows_the_clock_without_sync(channel):
    simulation = Simulation(SMALL, ServeOptions(bus=f"virtual:{channel}", pacing="real"))
    world, advanced = simulation.arms[0].world, threading.Event()
    forward = world.advance

    def advance(ticks: int) -> None:
        forward(ticks)
        if world.time_s > 0.05:
            advanced.set()

    world.advance = advance
    thread = threading.Thread(target=simulation.run)
    thread.start()
    try:
        assert advanced.wait(5.0)
    finally:
        simulation.stop()
        thread.join()
        simulation.close()


def test_a_load_that_no_server_mounts_is_an_error(monkeypatch, channel):
    monkeypatch.setattr("sim.server.MOUNT_S", 0.0)
    simulation = Simulation(SMALL, ServeOptions(bus=f"virtual:{channel}"))
    with pytest.raises(TimeoutError, match="not mounted"):
        simulation.mount("none")
    simulation.servers[0].bus.shutdown()
    simulation.close()


@pytest.mark.parametrize(("unbuffered", "count", "too_fast"), [(True, 50, True), (True, 0, False), (False, 9, False)])
def test_a_master_that_sends_too_fast_moves_drives_without_a_buffer_too_fast(unbuffered, count, too_fast, channel):
    """Setpoints for 10 ms every 2 ms: what takes them when they come is driven beyond its speed."""
    options = ServeOptions(bus=f"virtual:{channel}", pacing="real", unbuffered=unbuffered)
    simulation = Simulation(SMALL, options)
    unit = simulation.arms[0]
    drive, limit = unit.drives[2], simulation.cell.arms[0].axes[2].speed_limit_rad_s
    drive.motion.take_mode(8)
    for word in (0x06, 0x07, 0x0F):
        drive.take_controlword(word)
    unit.advance(0.1)
    drive.axis.fastest_rad_s = 0.0
    start, step = drive.position_counts(), round(0.9 * limit * 0.01 * drive.motion.counts_per_joint_rad)
    for number in range(1, count + 1):
        drive.motion.take_target(start + step * number)
        unit.advance(0.002)
    unit.advance(0.1)
    simulation.servers[0].bus.shutdown()
    simulation.close()
    assert (drive.axis.fastest_rad_s > 1.2 * limit) == too_fast


@pytest.mark.parametrize("held", [0, 9])
@pytest.mark.parametrize(
    "delay_s",
    [(0.0,), (0.004,), (0.007,), (0.009,), (0.014,), (0.006, 0.006), (0.0061, 0.0049), (0.009, 0.006, 0.006)],
    ids=str,
)
def test_delayed_setpoints_change_the_delay_of_a_drive_for_a_moment_only(delay_s, held, channel):
    """In real time: drives are locked to the SYNC; else two arms with unlike histories would pull at a common part."""
    simulation = Simulation(SMALL, ServeOptions(bus=f"virtual:{channel}", pacing="real"))
    unit = simulation.arms[0]
    drive = unit.drives[2]
    drive.motion.take_mode(8)
    for word in (0x06, 0x07, 0x0F):
        drive.take_controlword(word)
    period_s = drive.motion.period_s()
    for _ in range(held):  # the master holds the position while the brake opens
        drive.motion.take_target(drive.position_counts())
        unit.advance(period_s)
    if not held:
        unit.advance(0.1037)
    start, step = drive.position_counts(), round(0.001 * drive.motion.counts_per_joint_rad)
    came_s = np.arange(1, 31) * period_s
    came_s[20 : 20 + len(delay_s)] += delay_s
    came_s = np.maximum.accumulate(came_s)
    now_s = 0.0
    for number, at_s in enumerate(came_s, start=1):
        unit.advance(at_s - now_s)
        now_s = at_s
        drive.motion.take_target(start + step * number)
    behind = start + step * len(came_s) - drive.axis.servo.reference_rad * drive.motion.counts_per_joint_rad
    simulation.servers[0].bus.shutdown()
    simulation.close()
    assert period_s == pytest.approx(0.01)
    assert behind / step == pytest.approx(1.5, abs=0.05)


def test_pacing_of_the_command_line_is_that_of_every_bus_and_its_posture_that_of_the_arm(channel):
    posture = [0.3, -0.2, 0.4, 0.1, 0.5, -0.6]
    text = ",".join(map(str, posture))
    simulation = Simulation(SMALL, ServeOptions(bus=f"virtual:{channel}", pacing="real", posture=text))
    assert simulation.arms[0].world.q_rad == pytest.approx(posture)
    simulation.servers[0].bus.shutdown()
    simulation.close()
    assert {bus.pacing for bus in simulation.cell.buses.values()} == {"real"}
    assert {bus.pacing for bus in simulation.specs.values()} == {"real"}
    assert all(drive.motion.buffered for drive in simulation.servers[0].drives)
    with pytest.raises(CellFileError, match="lockstep or real"):
        Simulation(SMALL, ServeOptions(bus=f"virtual:{channel}", pacing="hasty"))
    assert serve(str(SMALL), "--pacing", "hasty").returncode == 2


def test_the_command_line_says_the_same_options():
    options = ServeOptions(bus="virtual:x", pacing="lockstep", unbuffered=True)
    assert command(SMALL, options)[-5:] == ["--bus", "virtual:x", "--pacing", "lockstep", "--unbuffered"]
    assert "--pacing" not in command(SMALL, ServeOptions(bus="virtual:x"))


def test_the_line_that_asks_for_a_load_is_recognised():
    """The demo mounts the load that `commission` asks for; the tests of commission read the same line."""
    asked = LOAD_PROMPT.search("HANG LOAD gripper\n")
    assert asked is not None
    assert asked.group(1) == "gripper"


def test_truth_beside_the_estimate():
    result = {
        "loads": [
            {
                "label": "a",
                "mass_kg": 70.5,
                "mass_std_kg": 0.25,
                "com_m": [0.01, None, 0.2],
                "com_std_m": [0.002, None, 0.004],
            }
        ],
        "verdict": "none_needed",
        "effects": [],
        "truth": {"loads": [{"label": "a", "mass_kg": 70.0, "com_m": [0.0, 0.0, 0.21]}], "effects": []},
    }
    lines = comparison(result)
    assert lines[1].split() == ["a", "mass", "[kg]", "70.00", "70.50", "0.50", "0.25", "2.00"]
    assert lines[3].endswith("not identifiable")
    assert lines[4].split()[-4:] == ["200.00", "-10.00", "4.00", "-2.50"]
    assert lines[5] == "undeclared effects: none; found: none; verdict: none_needed"
    assert len(lines) == 6


def test_truth_beside_an_effect_that_was_found():
    spring = {"name": "balancer_spring", "joints": [2], "parameters": {"stiffness_n_m": 4e4}}
    result = {
        "loads": [],
        "verdict": "explained",
        "effects": [spring],
        "before": {"holdout_rms_nm": [1.0, 800.0, None, 2.0, 1.0, 1.0]},
        "after": {"holdout_rms_nm": [1.0, 8.0, None, 2.0, 1.0, 1.0]},
        "truth": {"loads": [], "effects": [spring]},
    }
    named, residual = comparison(result)[1:]
    assert named == "undeclared effects: balancer_spring; found: balancer_spring; verdict: explained"
    assert "1 > 1, 800 > 8, 2 > 2" in residual


def test_the_demo_starts_both_programs_without_waiting_for_the_clock(monkeypatch, tmp_path):
    started = []

    class Program:
        stdin = stdout = None

        def __init__(self, words, **_options):
            started.append(list(words))

        def __enter__(self):
            return self

        def __exit__(self, *_exception):
            return None

        def terminate(self):
            return None

        def communicate(self, timeout=None):
            return "", ""

    monkeypatch.setattr("sim.demo.subprocess.Popen", Program)
    monkeypatch.setattr("sim.serve.wait_until_ready", lambda _process: "ready")
    done = CliRunner().invoke(demo_command, ["-o", str(tmp_path)])
    assert done.exit_code == 1
    simulator, gateway = started
    assert "sim" in simulator
    assert "commission" in gateway
    for words in (simulator, gateway):
        assert words[words.index("--pacing") + 1] == "lockstep"


@pytest.mark.parametrize("cell", sorted(EXAMPLES.glob("*/*.toml")), ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_the_examples_run_by_the_clock(cell):
    buses = tomllib.loads(cell.read_text(encoding="utf-8")).get("bus", {})
    assert {bus["pacing"] for bus in buses.values()} <= {"real"}


def test_the_demo_hides_what_its_own_file_says(monkeypatch):
    ran = []
    monkeypatch.setattr("sim.demo.run", lambda _cell, _payload, *drawn: ran.append(drawn) or 0)
    runner = CliRunner()
    assert runner.invoke(demo_command, []).exit_code == 0
    assert runner.invoke(demo_command, ["--seed", "3"]).exit_code == 0
    assert runner.invoke(demo_command, ["--seed", "3", "--undeclared", str(SMALL)]).exit_code == 2
    (hidden, no_seed, _out), (undeclared, seed, _out) = ran
    (effect,) = tomllib.loads(hidden.read_text(encoding="utf-8"))["effect"]
    assert (effect["name"], effect["joints"], no_seed) == ("balancer_spring", [2], None)
    assert (undeclared, seed) == (None, 3)


def test_help_is_given_by_the_short_option_too():
    for words in (["-h"], ["serve", "-h"]):
        done = CliRunner().invoke(sim_command, words)
        assert done.exit_code == 0
        assert done.output.startswith("Usage: ")
