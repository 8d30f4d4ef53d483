"""One simulated drive on the wire, judged frame by frame against CiA 301 and CiA 402-2."""

from __future__ import annotations

import math
import struct
import threading

import pytest

NODE = 3  # small cell: ratio 100, signs +1, counts from 0x608F


def test_boot_up_is_announced_and_identity_is_there(drives):
    master, _ = drives
    assert master.number(NODE, 0x1000) & 0xFFFF == 0x0192
    assert master.number(NODE, 0x1018, 0) == 4
    assert master.number(NODE, 0x6502) == 1 << 0 | 1 << 6 | 1 << 7 | 1 << 9
    master.send(0x000, bytes([129, NODE]))
    assert master.wait(0x700 + NODE) == b"\x00"


def test_every_node_says_that_it_is_simulated(drives):
    master, _ = drives
    assert {master.read(node, 0x5FFE) for node in range(1, 7)} == {b"servo-sim"}


def test_strings_come_in_segments(drives):
    master, _ = drives
    assert master.read(NODE, 0x1008) == b"simulated servo drive, generic-cia402"
    assert master.read(NODE, 0x100A) == b"simulated firmware 1.0.0"


@pytest.mark.parametrize(
    ("index", "sub", "write", "code"),
    [
        (0x2345, 0, False, 0x06020000),
        (0x1018, 9, False, 0x06090011),
        (0x6041, 0, True, 0x06010002),
        (0x6060, 0, True, 0x06090030),
        (0x1600, 1, True, 0x06010000),
    ],
)
def test_sdo_refuses_with_the_code_of_the_standard(drives, index, sub, write, code):
    master, _ = drives
    size = {0x6041: 2, 0x6060: 1}.get(index, 4)
    with pytest.raises(master.Aborted) as caught:
        master.write(NODE, index, sub, 5, size) if write else master.read(NODE, index, sub)
    assert caught.value.code == code


def test_sdo_refuses_a_wrong_length_a_wrong_toggle_and_a_segment_without_transfer(drives):
    master, _ = drives
    with pytest.raises(master.Aborted) as length:
        master.write(NODE, 0x6072, 0, 1, 4)
    assert length.value.code == 0x06070010
    with pytest.raises(master.Aborted) as command:
        master.request(NODE, bytes([0x60]))
    assert command.value.code == 0x05040001
    master.request(NODE, struct.pack("<BHB", 0x40, 0x1008, 0))
    with pytest.raises(master.Aborted) as toggle:
        master.request(NODE, bytes([0x70]))
    assert toggle.value.code == 0x05030000


def test_a_segmented_download_arrives_whole(drives):
    master, _ = drives
    master.request(NODE, struct.pack("<BHBI", 0x21, 0x6081, 0, 4))
    master.request(NODE, bytes([0x01 | 3 << 1]) + struct.pack("<I", 123456))
    assert master.number(NODE, 0x6081) == 123456


def test_a_map_is_taken_as_it_is_written(drives):
    master, _ = drives
    odd = (0x60640020, 0x10010008, 0x60610008, 0x60770010)
    can_id = master.map(NODE, 1, odd, 2)
    master.write(NODE, 0x6060, 0, 8, 1)
    master.send(0x000, bytes([1, NODE]))
    master.drain()
    master.sync(6)
    frames = [frame for frame in master.drain() if frame.arbitration_id == can_id]
    assert len(frames) == 3
    position, register, mode, _ = struct.unpack("<iBbh", bytes(frames[0].data))
    assert (position, register, mode) == (master.number(NODE, 0x6064, signed=True), 0, 8)


def test_a_map_cannot_be_changed_while_it_is_used_nor_hold_what_does_not_fit(drives):
    master, _ = drives
    master.map(NODE, 0, (0x60410010,), 1)
    for sub, value, size, code in ((0, 0, 1, 0x06010000), (1, 0x60640020, 4, 0x06010000)):
        with pytest.raises(master.Aborted) as caught:
            master.write(NODE, 0x1A00, sub, value, size)
        assert caught.value.code == code
    master.write(NODE, 0x1800, 1, 0x80000183, 4)
    master.write(NODE, 0x1A00, 0, 0, 1)
    for value, code in ((0x60640010, 0x06040041), (0x10080000, 0x06040041), (0x23450008, 0x06020000)):
        with pytest.raises(master.Aborted) as caught:
            master.write(NODE, 0x1A00, 1, value, 4)
        assert caught.value.code == code
    for sub in (1, 2, 3):
        master.write(NODE, 0x1A00, sub, 0x60640020, 4)
    with pytest.raises(master.Aborted) as caught:
        master.write(NODE, 0x1A00, 0, 3, 1)
    assert caught.value.code == 0x06040042


def test_an_event_driven_tpdo_is_sent_on_change_alone(drives):
    master, _ = drives
    master.send(0x000, bytes([1, NODE]))
    assert struct.unpack("<H", master.wait(0x180 + NODE))[0] & 0x4F == 0x40
    master.drain()
    master.sync(5)
    assert 0x180 + NODE not in {frame.arbitration_id for frame in master.drain()}
    master.send(0x200 + NODE, struct.pack("<H", 0x06))
    master.sync()
    assert struct.unpack("<H", master.wait(0x180 + NODE))[0] & 0x6F == 0x21


def test_a_synchronous_rpdo_waits_for_the_sync(drives):
    master, _ = drives
    master.configure(NODE, 8)
    master.send(0x200 + NODE, struct.pack("<Hih", 0x06, 0, 0))
    assert master.number(NODE, 0x6041) & 0x4F == 0x40
    master.sync()
    assert master.number(NODE, 0x6041) & 0x6F == 0x21


def test_brake_holds_until_operation_is_enabled_and_torque_is_zero_there(drives):
    master, simulation = drives
    master.configure(NODE, 8)
    position = master.number(NODE, 0x6064, signed=True)
    readings = [master.cycle(NODE, 0x06, position) for _ in range(20)]
    assert {reading[1:] for reading in readings} == {(position, 0)}
    assert master.number(NODE, 0x60FD) >> 16 & 1 == 1
    master.enable(NODE, 200)
    _, _, torque = master.cycle(NODE, 0x0F, position)
    assert master.number(NODE, 0x60FD) >> 16 & 1 == 0
    world = simulation.simulation.arms[0].world
    rated_nm = master.number(NODE, 0x6076) * 1e-3
    joint_nm = torque / 1000 * rated_nm * 100
    assert joint_nm == pytest.approx(world.axes[2].servo.u_nm, abs=4 * world.plant.reading_noise_nm[2])
    for _ in range(20):
        _, _, torque = master.cycle(NODE, 0x07, position)
    assert torque == 0


def test_the_axis_follows_the_target_of_every_sync(drives):
    master, simulation = drives
    master.configure(NODE, 8)
    start = master.enable(NODE)
    resolution = master.number(NODE, 0x608F, 1)
    world = simulation.simulation.arms[0].world
    before = start * 2 * math.pi / resolution / 100
    goal = round(0.1 * 100 * resolution / (2 * math.pi))
    for k in range(1, 201):
        status, _, _ = master.cycle(NODE, 0x0F, start + goal * k // 200)
        assert status & 1 << 12
    for _ in range(150):
        _, position, _ = master.cycle(NODE, 0x0F, start + goal)
    assert (position - start) / goal == pytest.approx(1.0, abs=5e-3)
    assert world.q_rad[2] - before == pytest.approx(0.1, abs=5e-4)


def test_torque_offset_shifts_the_load_from_the_loop_to_the_feedforward(drives):
    master, simulation = drives
    master.configure(NODE, 8)
    position = master.enable(NODE, 300)
    servo = simulation.simulation.arms[0].world.axes[2].servo
    torque = servo.u_nm
    rated_nm = master.number(NODE, 0x6076) * 1e-3
    word = round(torque / 100 / rated_nm * 1000)
    held = [master.cycle(NODE, 0x0F, position, word)[1] for _ in range(300)]
    assert servo.offset_nm == pytest.approx(torque, rel=0.01)
    sagged = [master.cycle(NODE, 0x0F, position)[1] for _ in range(4)]
    assert abs(sagged[-1] - held[-1]) > 500  # what the loop does not carry is missing at once


def test_a_software_limit_cuts_the_target_and_shows_bit_11(drives):
    master, _ = drives
    master.configure(NODE, 8)
    start = master.enable(NODE)
    limit = start + 2000
    master.write(NODE, 0x607D, 2, limit, 4)
    for _ in range(200):
        status, position, _ = master.cycle(NODE, 0x0F, start + 100_000)
    assert status & 1 << 11
    assert position == pytest.approx(limit, abs=250)


def test_following_error_ends_in_fault_with_emergency_and_history(drives):
    master, simulation = drives
    master.configure(NODE, 8)
    start = master.enable(NODE)
    master.write(NODE, 0x6072, 0, 1, 2)  # no torque left: the arm drops
    master.write(NODE, 0x6065, 0, 2000, 4)
    for _ in range(100):
        status, _, _ = master.cycle(NODE, 0x0F, start)
    assert status & 0x4F == 0x08
    assert status & 1 << 13
    emergency = next(bytes(frame.data) for frame in master.drain() if frame.arbitration_id == 0x80 + NODE)
    assert struct.unpack("<HB5s", emergency)[0] == 0x8611
    assert master.number(NODE, 0x603F) == master.number(NODE, 0x1003, 1) & 0xFFFF == 0x8611
    assert not simulation.simulation.arms[0].world.axes[2].free
    master.cycle(NODE, 0x00, start)
    status, _, _ = master.cycle(NODE, 0x80, start)
    status, _, _ = master.cycle(NODE, 0x80, start)
    assert status & 0x4F == 0x40
    assert master.number(NODE, 0x603F) == 0


@pytest.mark.parametrize(("option", "state"), [(3, 0x40), (2, 0x40), (1, 0x08)])
def test_loss_of_the_masters_heartbeat_ends_as_0x6007_says(drives, option, state):
    master, simulation = drives
    master.configure(NODE, 8)
    master.write(NODE, 0x6007, 0, option, 2)
    master.write(NODE, 0x1016, 1, 0x7F << 16 | 100, 4)
    position = master.enable(NODE)
    for _ in range(30):
        master.send(0x77F, b"\x05")
        status, _, _ = master.cycle(NODE, 0x0F, position)
    assert status & 0x6F == 0x27
    cycles = 0
    while status & 0x6F == 0x27 and cycles < 30:
        status, _, _ = master.cycle(NODE, 0x0F, position)
        cycles += 1
    assert 10 <= cycles <= 12
    for _ in range(30):
        status, _, _ = master.cycle(NODE, 0x0F, position)
    assert status & 0x4F == state
    assert not simulation.simulation.arms[0].world.axes[2].free
    emergencies = [bytes(frame.data) for frame in master.drain() if frame.arbitration_id == 0x80 + NODE]
    assert struct.unpack_from("<H", emergencies[0])[0] == 0x8130
    assert master.number(NODE, 0x1001) == 0x11

    master.send(0x77F, b"\x05")
    master.cycle(NODE, 0x00, position)
    cleared = [bytes(frame.data)[:3] for frame in master.drain() if frame.arbitration_id == 0x80 + NODE]
    assert cleared == ([] if option == 1 else [b"\x00\x00\x00"]), "a fault keeps the register until its reset"
    assert master.number(NODE, 0x1001) == (0x11 if option == 1 else 0)


def test_a_consumer_that_never_received_a_heartbeat_does_not_watch(drives):
    master, _ = drives
    master.configure(NODE, 8)
    master.write(NODE, 0x1016, 1, 0x7F << 16 | 20, 4)
    position = master.enable(NODE)
    status, _, _ = master.cycle(NODE, 0x0F, position)
    assert status & 0x6F == 0x27


def test_quick_stop_ramps_down_and_switches_off(drives):
    master, simulation = drives
    axis, target = moving(master, simulation)
    states, speeds = stop(master, axis, 0x02, target, 60)
    assert states[0] == 0x07
    assert 0.1 < speeds[1] < 0.5
    assert states[-1] & 0x4F == 0x40
    assert not axis.free


def moving(master, simulation):
    """Axis 3 at half its speed limit; returns its motor and the position for the next command."""
    master.configure(NODE, 8)
    start = master.enable(NODE)
    step = round(0.5 * 0.01 * 100 * 131072 / (2 * math.pi))
    for k in range(60):
        master.cycle(NODE, 0x0F, start + k * step)
    axis = simulation.simulation.arms[0].world.axes[2]
    assert axis.omega_rad_s == pytest.approx(0.5, rel=0.05)
    return axis, start + 60 * step


def stop(master, axis, word, target, cycles=100):
    """Speed and state after each SYNC."""
    seen = [(master.cycle(NODE, word, target)[0] & 0x6F, abs(axis.omega_rad_s)) for _ in range(cycles)]
    return [state for state, _ in seen], [speed for _, speed in seen]


def test_a_quick_stop_that_coasts_is_braked_by_the_brake_alone(drives):
    master, simulation = drives
    axis, target = moving(master, simulation)
    master.write(NODE, 0x605A, 0, 0, 2)
    states, speeds = stop(master, axis, 0x02, target, 30)
    assert states[0] & 0x4F == 0x40
    assert not axis.fed
    assert speeds[3] > 0.3  # the brake falls in after 0.05 s
    assert axis.servo.u_nm == 0.0
    assert speeds[10:] == [0.0] * 20
    assert not axis.free


def test_ramps_of_a_quick_stop_are_those_of_its_option(drives):
    master, simulation = drives
    durations = []
    for option, ramp in ((2, 0x6085), (1, 0x6084)):
        master.write(NODE, 0x605A, 0, option, 2)
        axis, target = moving(master, simulation)
        stated = master.number(NODE, ramp)
        for scale in (1, 2):
            master.write(NODE, ramp, 0, stated // scale, 4)
            states, _ = stop(master, axis, 0x02, target, 200)
            durations.append(states.count(0x07))
            assert states[-1] & 0x4F == 0x40
            if scale == 1:
                axis, target = moving(master, simulation)
    # from 0.5 rad/s on 8 rad/s2, on 0.8 rad/s2, and on half of each; then the axis still has to catch up
    quick, half_as_quick, gentle, half_as_gentle = durations
    assert 6 <= quick < half_as_quick
    assert gentle == pytest.approx(62, abs=12)
    assert half_as_gentle - gentle == pytest.approx(62, abs=8)


@pytest.mark.parametrize(("option", "word", "end"), [(0x605C, 0x07, 0x23), (0x605B, 0x06, 0x21)])
def test_disabling_slows_down_first_where_the_option_says_so(drives, option, word, end):
    master, simulation = drives
    axis, target = moving(master, simulation)
    master.write(NODE, option, 0, 1, 2)
    states, speeds = stop(master, axis, word, target)
    still = states.index(end)
    assert still > 5
    assert set(states[:still]) == {0x27}
    assert max(speeds[still:]) < 0.02
    assert all(later < earlier + 0.02 for earlier, later in zip(speeds, speeds[1:], strict=False))
    master.write(NODE, option, 0, 0, 2)
    axis, target = moving(master, simulation)
    states, speeds = stop(master, axis, word, target, 10)
    assert states[0] == end
    assert speeds[2] > 0.3


@pytest.mark.parametrize(("option", "ramps"), [(0, False), (1, True), (2, True)])
def test_a_fault_is_answered_as_0x605e_says(drives, option, ramps):
    master, simulation = drives
    axis, target = moving(master, simulation)
    master.write(NODE, 0x605E, 0, option, 2)
    drive = simulation.simulation.servers[0].drive(NODE)
    done = threading.Event()
    simulation.simulation.servers[0].later(lambda: (drive.raise_fault(0x7305), done.set()))
    assert done.wait(5.0)
    states, _ = stop(master, axis, 0x0F, target)
    assert (0x0F in states) == ramps
    assert states[-1] & 0x4F == 0x08
    assert not axis.free


@pytest.mark.parametrize(("index", "good", "bad"), [(0x605A, 0, 4), (0x605B, 1, 2), (0x605C, 1, 2), (0x605D, 2, 3)])
def test_option_codes_are_parameters(drives, index, good, bad):
    master, _ = drives
    master.write(NODE, index, 0, good, 2)
    assert master.number(NODE, index) == good
    with pytest.raises(master.Aborted) as caught:
        master.write(NODE, index, 0, bad, 2)
    assert caught.value.code == 0x06090030


def test_profile_position_handshake(drives):
    master, _ = drives
    master.configure(NODE, 1)
    start = master.enable(NODE)
    goal = start + 20_000
    status, _, _ = master.cycle(NODE, 0x0F, goal)
    assert not status & 1 << 12
    master.cycle(NODE, 0x1F, goal)
    status, _, _ = master.cycle(NODE, 0x1F, goal)
    assert status & 1 << 12
    assert not status & 1 << 10
    master.cycle(NODE, 0x0F, goal)
    status, _, _ = master.cycle(NODE, 0x0F, goal)
    assert not status & 1 << 12
    for _ in range(400):
        status, position, _ = master.cycle(NODE, 0x0F, goal)
        if status & 1 << 10:
            break
    assert status & 1 << 10
    assert position == pytest.approx(goal, abs=master.number(NODE, 0x6067))


def test_cyclic_synchronous_torque_commands_torque(drives):
    master, simulation = drives
    master.configure(6, 10)
    master.write(6, 0x6071, 0, 0, 2)
    position = master.enable(6)
    master.write(6, 0x6071, 0, 150, 2)
    for _ in range(10):
        master.cycle(6, 0x0F, position)
    axis = simulation.simulation.arms[0].world.axes[5]
    rated_nm = master.number(6, 0x6076) * 1e-3
    assert axis.servo.u_nm == pytest.approx(0.150 * rated_nm * 50, rel=1e-3)


def test_signs_of_position_and_torque_are_the_cells(drives):
    """Axis 2 of the small cell: both signs are -1, the zero of the joint is 0.02 rad from that of the drive."""
    master, simulation = drives
    world = simulation.simulation.arms[0].world
    counts = master.number(2, 0x6064, signed=True)
    resolution = master.number(2, 0x608F, 1)
    motor_rad = counts * 2 * math.pi / resolution
    assert -motor_rad / 120 + 0.02 == pytest.approx(world.q_rad[1], abs=1e-6)
    master.configure(2, 8)
    position = master.enable(2, 200)
    torques = [master.cycle(2, 0x0F, position)[2] for _ in range(50)]
    joint_nm = -sum(torques) / 50 / 1000 * master.number(2, 0x6076) * 1e-3 * 120
    assert joint_nm == pytest.approx(world.axes[1].servo.u_nm, rel=0.05)


def test_nmt_stop_silences_sdo_and_reset_restores_the_power_on_values(drives):
    master, simulation = drives
    master.map(NODE, 0, (0x60640020,), 1)
    master.write(NODE, 0x6065, 0, 77, 4)
    master.write(NODE, 0x60B1, 0, 5000, 4)
    master.send(0x000, bytes([2, NODE]))
    master.send(0x600 + NODE, struct.pack("<BHB", 0x40, 0x1000, 0).ljust(8, b"\x00"))
    assert not [frame for frame in master.drain() if frame.arbitration_id == 0x580 + NODE]
    master.send(0x000, bytes([130, NODE]))
    assert master.wait(0x700 + NODE) == b"\x00"
    assert master.number(NODE, 0x6065) != 77
    servo = simulation.simulation.servers[0].drive(NODE).axis.servo
    assert (master.number(NODE, 0x60B1), servo.offset_rad_s) == (0, 0.0)
    assert master.number(NODE, 0x1A00, 1) == 0x60410010


def test_heartbeat_reports_the_state_while_simulated_time_runs(drives):
    master, _ = drives
    master.write(NODE, 0x1017, 0, 50, 2)
    master.send(0x000, bytes([1, NODE]))
    master.drain()
    master.sync(100)
    beats = [bytes(frame.data) for frame in master.drain() if frame.arbitration_id == 0x700 + NODE]
    assert len(beats) >= 18
    assert set(beats) == {b"\x05"}


def test_a_short_rpdo_is_reported_and_not_used(drives):
    master, _ = drives
    master.configure(NODE, 8)
    master.send(0x200 + NODE, b"\x06")
    master.sync()
    assert struct.unpack_from("<H", master.wait(0x80 + NODE))[0] == 0x8210
    assert master.number(NODE, 0x6041) & 0x4F == 0x40
