"""The checks that move the arm: stopping on loss of the master, proven before anything else moves."""

from __future__ import annotations

import json

import pytest

DEAF = '[[fault]]\nkind = "heartbeat_ignored"\nnode = {}\n'


def check(gateway, place, drives, *more, cell=None, **options):
    done = gateway(
        "check",
        cell or place.cell,
        "--bus",
        drives.bus,
        "--json",
        place.folder / "check.json",
        *more,
        **options,
    )
    path = place.folder / "check.json"
    body = json.loads(path.read_text()) if path.exists() else {"findings": []}
    return done, body


def failed(body):
    return [item for item in body["findings"] if item["severity"] == "fail"]


# ---------------------------------------------------------------------------------------------- loss of the master


@pytest.mark.slow
def test_every_drive_stops_when_the_heartbeat_is_withheld(place, gateway, serve):
    drives = serve()
    done, body = check(gateway, place, drives, "--prove-stop", "--yes")
    assert done.exit_code == 0, done.output
    (proof,) = body["stop_proof"]
    assert [drive["node_id"] for drive in proof["drives"]] == [1, 2, 3, 4, 5, 6]
    for drive in proof["drives"]:
        assert 0.4 < drive["left_s"] <= drive["stated_s"] == pytest.approx(0.51)
        assert 0.01 < drive["moved_joint_rad"] < 0.05
        assert drive["coast_joint_rad"] < 0.01
    assert drives.stand_still()
    assert all(not drive.automaton.state.name.startswith("FAULT") for drive in drives.handle.simulation.arms[0].drives)


def test_a_drive_that_goes_on_without_its_master_is_found_and_stopped(place, gateway, serve):
    drives = serve(fault=DEAF.format(4))
    done, body = check(gateway, place, drives, "--prove-stop", "--yes")
    assert done.exit_code == 7, done.output
    (item,) = failed(body)
    assert item["where"].startswith("J4 node 4")
    assert "without the master's heartbeat" in item["what"]
    assert "do not move this arm" in item["advice"]
    assert drives.stand_still()


@pytest.mark.parametrize("option", ["--move", "--prove-stop"])
def test_nothing_moves_without_a_yes_or_with_a_failed_check(place, gateway, serve, option):
    drives = serve()
    done, _ = check(gateway, place, drives, option, input="n\n")
    assert done.exit_code == 130
    faulty = serve(fault='[[fault]]\nkind = "fault_at_start"\nnode = 3\n')
    done, body = check(gateway, place, faulty, option, "--yes")
    assert done.exit_code == 7
    assert "nothing has moved" in done.stderr
    for each in (drives, faulty):
        assert each.handle.simulation.servers[0].sync_count == 0
        assert each.stand_still()


def test_no_space_no_motion(place, gateway, serve):
    drives = serve()
    cell = place.variant("narrow", ("position_limit_rad = [-2.8, 2.8]", "position_limit_rad = [-0.02, 0.02]"))
    done, _ = check(gateway, place, drives, "--prove-stop", "--yes", cell=cell)
    assert done.exit_code == 5, done.output
    assert "no free space" in done.stderr
    assert drives.stand_still()


@pytest.mark.slow
def test_a_command_that_moves_needs_the_proof_once(place, gateway, serve, fast_cell):
    drives = serve()
    first = gateway("move", place.cell, "--bus", drives.bus, "--to", "home", "--yes")
    assert first.exit_code == 0, first.output
    assert "every drive stopped by itself" in first.stderr
    again = gateway("move", place.cell, "--bus", drives.bus, "--to", "0.1,-0.2,0.4,0,0.3,0", "--yes")
    assert again.exit_code == 0, again.output
    assert "proven 20" in again.stderr


@pytest.mark.slow
def test_recording_is_refused_where_a_drive_goes_on(place, gateway, serve, commission, fast_cell):
    drives = serve(fault=DEAF.format(2))
    done = gateway("record", place.cell, "--bus", drives.bus, "--load", "none", "-o", place.run, "--yes")
    assert done.exit_code == 7, done.output
    assert "J2 node 2" in done.stderr
    assert not place.run.exists()
    code, result, hands, output = commission(drives)
    assert code == 7, output.err
    assert result is None
    assert hands.asked == []
    assert drives.stand_still()


# ------------------------------------------------------------------------------------------------------ small moves

WRONG = '[[effect]]\nname = "{}"\njoints = {}\n'
WRONG_TORQUE = '[[fault]]\nkind = "demand_torque"\nnode = 3\n[[fault]]\nkind = "unsigned_torque"\nnode = 4\n'


@pytest.mark.slow
def test_small_moves_of_a_good_cell_pass_and_say_what_they_cannot_see(place, gateway, serve, fast_cell):
    drives = serve()
    done, body = check(gateway, place, drives, "--move", "--yes")
    assert done.exit_code == 0, done.output
    assert body["stop_proof"], "the stop is proven before anything else moves"
    lines = {item["where"]: item for item in body["findings"] if "direction of rotation" in item["what"]}
    assert lines["J2 node 2"]["severity"] == lines["J3 node 3"]["severity"] == "ok"
    assert lines["J1 node 1"]["severity"] == "info", "gravity says nothing of an upright axis"
    warned = [item for item in body["findings"] if item["severity"] in ("warn", "fail")]
    assert not warned, "nothing is the matter with this arm"
    assert "joint 1 turned" in lines["J1 node 1"]["advice"]
    measured = [item for item in body["findings"] if "measured torque" in item["what"]]
    assert len(measured) == 6
    assert drives.stand_still()
    again, body = check(gateway, place, drives, "--yes")
    assert again.exit_code == 0, again.output
    assert "stop_proof" not in body


@pytest.mark.slow
def test_a_reversed_torque_a_demand_and_one_without_sign_are_named(place, gateway, serve, fast_cell):
    drives = serve(fault=WRONG_TORQUE, effect=WRONG.format("sign_reversed", [2]))
    done, body = check(gateway, place, drives, "--move", "--yes")
    assert done.exit_code == 7, done.output
    found = {item["where"]: item["what"] for item in failed(body)}
    assert found["J2 node 2"] == "torque sign is reversed relative to position"
    assert "opposite sign of the demand" in found["J2 node 2:6077:00 (torque)"]
    assert "it is a demand" in found["J3 node 3:6077:00 (torque)"]
    assert "magnitude only" in found["J4 node 4:6077:00 (torque)"]
    assert len(found) == len(failed(body)) == 4


def test_drives_whose_limits_give_them_away_are_named_before_anything_moves(place, gateway, serve):
    drives = serve(effect=WRONG.format("axes_swapped", [2, 3]))
    done, body = check(gateway, place, drives, "--move", "--yes")
    assert done.exit_code == 7, done.output
    first, second = failed(body)
    assert "the drives of J2 and J3 look swapped" in first["what"]
    assert "node ids 2 and 3" in first["advice"]
    assert second["where"] == "J2 node 2:607D:01 (position_limit_min)"
    assert "the drives of J2 and J3 look swapped" in " ".join(done.output.split())
    assert "stop_proof" not in body
    assert drives.stand_still()


@pytest.mark.slow
def test_swapped_drives_are_named(place, gateway, serve, fast_cell):
    """Of one ratio and one range: else the drives' software limits give them away before anything moves."""
    text = place.cell.read_text()
    for old, new in (("[-1.5, 1.8]", "[-1.5, 1.5]"), ("[-1.3, 1.8]", "[-1.5, 1.5]"), ("value = 100,", "value = 120,")):
        assert old in text
        text = text.replace(old, new, 1)
    place.cell.write_text(text)
    done, body = check(gateway, place, serve(effect=WRONG.format("axes_swapped", [2, 3])), "--move", "--yes")
    assert done.exit_code == 7, done.output
    assert [item["what"] for item in failed(body)] == ["the drives of J2 and J3 are swapped"]
    (item,) = failed(body)
    assert "node ids 2 and 3" in item["advice"]


@pytest.mark.slow
def test_a_wrong_gear_ratio_is_named_with_its_factor(place, gateway, serve, fast_cell):
    drives = serve()
    parts = place.cell.read_text().split("[[arm.axis]]")
    parts[2] = parts[2].replace("value = 120", "value = 60")
    cell = place.folder / "half.toml"
    cell.write_text("[[arm.axis]]".join(parts))
    done, body = check(gateway, place, drives, "--move", "--yes", cell=cell)
    assert done.exit_code == 7, done.output
    (item,) = failed(body)
    assert item["where"] == "J2 node 2"
    assert "gear_ratio is 0.4" in item["what"] or "gear_ratio is 0.5" in item["what"]
    assert drives.stand_still()
