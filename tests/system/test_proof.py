"""The proof of a stop on simulated drives: loss of the master, quick stop, the path back; and brakes that slip."""

from __future__ import annotations

import json

import pytest


def findings(done, where: str) -> list[dict]:
    return [each for each in json.loads(done.stdout)["findings"] if each["where"].startswith(where)]


@pytest.mark.slow
def test_the_proof_tries_both_stops_and_brings_the_arm_back(place, gateway, serve):
    drives = serve()
    (arm,) = drives.handle.simulation.arms
    before = [axis.position_rad for axis in arm.world.axes]
    done = gateway("check", place.cell, "--bus", drives.bus, "--prove-stop", "--yes", "--json", "-")
    assert done.exit_code == 0, done.output
    for joint in range(1, 7):
        said = [each["what"] for each in findings(done, f"J{joint} node {joint}") if each["severity"] == "ok"]
        assert any("left OPERATION ENABLED after" in what for what in said)
        assert any("quick stop: at rest after" in what for what in said)
    assert [axis.position_rad for axis in arm.world.axes] == pytest.approx(before, abs=2e-3)
    assert drives.stand_still()


@pytest.mark.slow
def test_a_brake_that_slips_is_found_and_one_that_holds_is_not(place, gateway, serve):
    drives = serve()
    held = gateway("check", place.cell, "--bus", drives.bus, "--brakes", "--yes", "--json", "-")
    assert held.exit_code == 0, held.output
    assert all("its brake held it" in findings(held, f"J{joint} node {joint}")[-1]["what"] for joint in range(1, 7))
    (arm,) = drives.handle.simulation.arms
    arm.world.axes[2].slip_rad_s = 0.02
    done = gateway("check", place.cell, "--bus", drives.bus, "--brakes", "--yes", "--json", "-")
    assert done.exit_code == 7, done.output
    tried = {joint: findings(done, f"J{joint} node {joint}")[-1] for joint in range(1, 7)}
    assert tried[3]["severity"] == "fail"
    assert "sank by" in tried[3]["what"]
    assert not any("brake" in tried[joint]["what"] for joint in (4, 5, 6))
    assert drives.stand_still()


@pytest.mark.slow
def test_a_brake_that_closes_slowly_is_found(place, gateway, serve):
    drives = serve()
    drives.handle.simulation.arms[0].drives[2].motion.brake_closing_s = 0.08
    done = gateway("check", place.cell, "--bus", drives.bus, "--brakes", "--yes", "--json", "-")
    assert done.exit_code == 7, done.output
    found = findings(done, "J3 node 3")[-1]
    assert found["severity"] == "fail"
    assert "in its brake" in found["what"]
    assert drives.stand_still()


@pytest.mark.slow
def test_an_axis_that_sinks_in_its_brake_does_not_stand_and_ends_the_proof(place, gateway, serve):
    drives = serve(fault='[[fault]]\nkind = "brake_slips"\nnode = 3\n')
    done = gateway("check", place.cell, "--bus", drives.bus, "--prove-stop", "--yes")
    assert done.exit_code == 4, done.output
    said = " ".join(done.stderr.split())
    assert "joint 3 sank by" in said
    assert "keep away from this arm" in said
    assert drives.stand_still()


def test_an_override_that_is_none_is_refused(place, gateway):
    for percent in (0, 101):
        done = gateway("record", place.cell, "--load", "none", "-o", place.run, "--yes", "--override", percent)
        assert done.exit_code == 2
        assert "1<=x<=100" in done.stderr


def test_a_key_cannot_be_held_without_a_terminal(place, gateway, serve):
    drives = serve()
    words = ("--bus", drives.bus, "--load", "none", "-o", place.run, "--yes", "--hold-to-run")
    done = gateway("record", place.cell, *words)
    assert done.exit_code == 3
    assert "needs a terminal" in done.stderr
    assert not place.run.exists()
