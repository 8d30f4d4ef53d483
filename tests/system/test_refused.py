"""Bad input and faults: typed error, exit code, remedy; the arm stays at rest, what was recorded is kept."""

import pytest

from tests.system.conftest import with_few_poses

OTHER_MAKE = ('profile = "generic-cia402"', 'profile = "maxon-epos4"')


def complains(done, code, *says):
    """One paragraph on stderr that says what and what to do, with this exit code."""
    assert done.exit_code == code, done.output
    lines = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    assert len(lines) == 1, done.stderr
    assert "Traceback" not in done.output
    for text in says:
        assert text.lower() in done.stderr.lower(), done.stderr


# ------------------------------------------------------------------------------------------ files, no bus needed


def test_a_profile_with_a_missing_constant(place, gateway, serve):
    from drives.profile_file import load_profile

    text = load_profile("generic-cia402").text
    (place.folder / "mine.toml").write_text(text.replace("unit = 0.001\n", "", 1))
    cell = place.variant("bad", ('profile = "generic-cia402"', 'profile = "mine.toml"'))
    complains(gateway("record", cell, "--load", "none", "-o", place.run, "--yes"), 3, "mine.toml", "unit")


def test_one_pose_is_refused(place, gateway):
    complains(gateway("plan", place.cell, "--poses", 1), 5, "one pose cannot identify a load")


# ----------------------------------------------------------------------------------------- before anything moves


#: The small cell with joint 1, at 0 rad, too far outside its range.
FAR_OUTSIDE = (
    ("position_limit_rad = [-2.8, 2.8]", "position_limit_rad = [0.4, 2.8]"),
    ("home_rad = [0.0", "home_rad = [0.5"),
    ("loading_rad = [0.0", "loading_rad = [0.5"),
)


@pytest.mark.slow
@pytest.mark.parametrize("words", [["move", "--to", "home"], ["record", "--load", "none", "-o", "run.h5"]])
@pytest.mark.parametrize(
    ("fault", "changes", "code", "says"),
    [
        ('[[fault]]\nkind = "fault_at_start"\nnode = 3\n', (), 4, "node 3"),
        ("", FAR_OUTSIDE, 5, "jog the joint back"),
    ],
)
def test_an_arm_that_cannot_be_moved_is_refused_before_the_question(
    place, gateway, serve, monkeypatch, words, fault, changes, code, says
):
    monkeypatch.chdir(place.folder)
    drives, cell = serve(fault=fault), place.variant("changed", *changes)
    done = gateway(*words, cell, "--bus", drives.bus, input="y\n")
    assert "area clear" not in done.output
    complains(done, code, says)
    assert drives.handle.simulation.servers[0].sync_count == 0


@pytest.mark.slow
def test_a_joint_outside_its_limits(place, gateway, serve):
    drives = serve()
    cell = place.variant("narrow", *FAR_OUTSIDE)
    done = gateway("record", cell, "--bus", drives.bus, "--load", "none", "-o", place.run, "--yes")
    complains(done, 5, "J1" if "J1" in done.stderr else "joint 1", "jog the joint back")
    assert drives.stand_still()
    assert not place.run.exists()
    complains(gateway("check", cell, "--bus", drives.bus), 7, "limits 0.4 to 2.8 rad")


@pytest.mark.slow
def test_a_drive_of_another_make(place, gateway, serve):
    drives = serve()
    done = gateway(
        "record", place.variant("other", OTHER_MAKE), "--bus", drives.bus, "--load", "none", "-o", place.run, "--yes"
    )
    complains(done, 4, "node 1", "vendor", "profile")
    assert drives.stand_still()
    complains(gateway("check", place.variant("other", OTHER_MAKE), "--bus", drives.bus), 7, "vendor")


def test_no_drive_at_all(place, gateway):
    done = gateway("record", place.cell, "--bus", "virtual:empty", "--load", "none", "-o", place.run, "--yes")
    complains(done, 4, "nodes 1 to 6", "no device answers")
    complains(gateway("scan", "--bus", "virtual:empty", "--listen", 0.1), 4, "no node answered")
    complains(gateway("scan", "--bus", "virtual"), 4, "INTERFACE:CHANNEL")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "says"),
    [
        ("node_missing", ["node 3", "no device answers"]),
        ("duplicate_node", ["node 3", "devices answer"]),
        ("sdo_aborted", ["node 3"]),
        ("sdo_silent", ["node 3"]),
        ("fault_at_start", ["node 3", "fault"]),
        ("rated_zero", ["node 3", "rated"]),
    ],
)
def test_a_drive_that_must_not_be_used(place, gateway, serve, kind, says):
    drives = serve(fault=f'[[fault]]\nkind = "{kind}"\nnode = 3\n')
    done = gateway("record", place.cell, "--bus", drives.bus, "--load", "none", "-o", place.run, "--yes")
    complains(done, 4, *says)
    assert drives.stand_still()
    assert not place.run.exists()


# ------------------------------------------------------------------------------------------ while it is measured


@pytest.mark.slow
def test_an_incomplete_epoch_is_sampled_again(place, gateway, serve, fast_arm):
    lost = '[[fault]]\nkind = "tpdo_lost"\nnode = 4\nsyncs = 1\nat_sync = {}\n'
    drives = serve(fault="".join(lost.format(sync) for sync in range(150, 1500, 50)))
    cell = place.variant("long", ("samples = 10", "samples = 30"), ("count = 4", "count = 2"))
    fast_arm(drives, cell)
    done = gateway("record", cell, "--bus", drives.bus, "--load", "none", "-o", place.run, "--yes")
    assert done.exit_code == 0, done.output
    assert "not answered by J4" in done.stderr
    (arm,) = place.recording().arms
    assert sum(visit.incomplete_epochs for visit in arm.visits) > 0
    assert all(len(visit) == 30 for visit in arm.visits)


@pytest.mark.slow
def test_a_pose_that_never_settles(place, gateway, serve, fast_arm):
    drives = serve(fault='[[fault]]\nkind = "never_settles"\nnode = 2\nat_sync = 300\n')
    cell = place.variant("short", ("[poses]", "[poses]\nsettle_timeout_s = 2.0"))
    fast_arm(drives, cell)
    done = gateway("record", cell, "--bus", drives.bus, "--load", "none", "-o", place.run, "--yes")
    complains(done, 5, "does not settle", "settle_timeout_s")
    assert drives.stand_still()
    recording = place.recording()
    assert recording.exit_status == "fail"
    assert any(visit.complete for visit in recording.arms[0].visits)


@pytest.mark.slow
def test_a_drive_that_faults_in_motion_and_the_run_is_resumed(place, gateway, serve, fast_arm):
    with_few_poses(place)
    drives = fast_arm(serve(fault='[[fault]]\nkind = "drive_fault"\nnode = 5\nat_sync = 250\n'))
    done = gateway("record", place.cell, "--bus", drives.bus, "--load", "none", "-o", place.run, "--yes")
    complains(done, 4, "node 5")
    assert drives.stand_still()
    kept = len([visit for visit in place.recording().arms[0].visits if visit.complete])
    assert kept > 0
    fresh = fast_arm(serve())
    again = gateway("record", place.cell, "--bus", fresh.bus, "--load", "none", "-o", place.run, "--yes", "--resume")
    assert again.exit_code == 0, again.output
    assert f"{kept} already recorded" in again.stdout
    assert place.recording().exit_status == "success"


def test_a_recording_is_never_written_over(place, gateway, serve):
    drives = serve()
    place.run.write_bytes(b"something else")
    done = gateway("record", place.cell, "--bus", drives.bus, "--load", "none", "-o", place.run, "--yes")
    complains(done, 3, "exists")
    assert place.run.read_bytes() == b"something else"


def test_nothing_moves_without_a_yes(place, gateway, serve):
    drives = serve()
    done = gateway("record", place.cell, "--bus", drives.bus, "--load", "none", "-o", place.run, input="n\n")
    assert done.exit_code == 130
    assert drives.stand_still()
    assert not place.run.exists()
