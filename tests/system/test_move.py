"""move: to a posture, slowly, asked, inside every limit; and the next step where another command cannot begin."""

from __future__ import annotations

import shlex

import pytest

pytestmark = pytest.mark.usefixtures("fast_cell")
#: Near to where the simulator's arm is at first.
NEAR = "0.05,-0.05,0.1,0.05,-0.05,0.1"


def move(gateway, place, drives, to, *more, cell=None, **options):
    return gateway("move", cell or place.cell, "--bus", drives.bus, "--to", to, *more, **options)


def said(done) -> str:
    """What was said, as one line."""
    return " ".join(done.output.split())


def narrow(place, limits):
    """The cell with other limits of joint 1, and without postures that they shut out."""
    text = place.cell.read_text().replace("position_limit_rad = [-2.8, 2.8]", f"position_limit_rad = {limits}", 1)
    kept = [line for line in text.splitlines() if not line.startswith(("home_rad", "loading_rad"))]
    path = place.folder / "narrow.toml"
    path.write_text("\n".join(kept) + "\n")
    return path


def test_it_asks_first_and_says_where_it_goes_and_how(place, gateway, serve):
    drives = serve()
    done = move(gateway, place, drives, "loading", input="n\n")
    assert done.exit_code == 130, done.output
    assert (
        "to the loading posture, [0.000, 0.500, 0.600, 0.000, 0.400, 0.000] rad ([0, 28.6, 34.4, 0, 22.9, 0]"
        in said(done)
    )
    assert "deg), at 10 % of its speed" in said(done)
    assert "Is the area clear of people?" in done.output
    assert drives.handle.simulation.servers[0].sync_count == 0
    assert drives.stand_still()


@pytest.mark.slow
def test_there_and_home_again_after_the_proof(place, gateway, serve):
    drives = serve()
    there = move(gateway, place, drives, NEAR, "--yes")
    assert there.exit_code == 0, there.output
    assert "every drive stopped by itself" in there.stderr
    assert drives.stand_still()
    refused = move(gateway, place, drives, "9,0,0,0,0,0", "--yes")
    assert refused.exit_code == 5, refused.output
    assert not list((place.folder / "state").rglob("*.blackbox.h5")), "no move was stopped"
    home = move(gateway, place, drives, "home", "--yes", "--override", 60)
    assert home.exit_code == 0, home.output
    assert "from [0.050, -0.050, 0.100, 0.050, -0.050, 0.100] rad (" in said(home)
    assert "deg) to home" in said(home)
    assert "at 60 % of its speed" in said(home)
    assert "every drive stopped by itself" in home.stderr, "the proof at 10 % does not hold for 60 %"
    again = move(gateway, place, drives, "home", "--yes", "--override", 50)
    assert again.exit_code == 0, again.output
    assert "proven 20" in again.stderr


@pytest.mark.parametrize(
    ("to", "code", "says"),
    [
        ("0.1,0.2", 2, "2 joint angles, and arm 'main' has 6 axes"),
        ("up", 2, "give one joint angle per axis"),
        ("nan,0,0,0,0,0", 2, "give one joint angle per axis"),
        ("3,0,0,0,0,0", 5, "joint 1 outside [-2.800, 2.800] rad"),
        ("90,0,0,0,0,0", 2, "write 90,0,0,0,0,0deg for degrees"),
        ("-1.2,1.3,1.0,0,0.4,0", 5, "link 5 in keep_out box 1"),
    ],
)
def test_a_posture_that_cannot_be_meant_is_refused_before_the_bus_is_opened(place, gateway, to, code, says):
    done = gateway("move", place.cell, "--bus", "virtual:empty", "--to", to, "--yes")
    assert done.exit_code == code, done.output
    assert says in said(done)


def test_a_place_for_loads_has_to_be_given(place, gateway):
    done = gateway("move", narrow(place, "[-2.8, 2.8]"), "--bus", "virtual:empty", "--to", "loading", "--yes")
    assert done.exit_code == 3, done.output
    assert "loading_rad is missing" in said(done)


def test_a_posture_of_the_cell_outside_its_limits_is_refused(place, gateway):
    cell = place.variant("bad", ("home_rad = [0.0, -0.2", "home_rad = [0.0, -1.6"))
    done = gateway("plan", cell)
    assert done.exit_code == 3, done.output
    assert "home_rad puts joint 2 at -1.6 rad" in said(done)


@pytest.mark.slow
def test_a_lost_drive_ends_it_in_the_brakes(place, gateway, serve):
    drives = serve(fault='[[fault]]\nkind = "drive_fault"\nnode = 5\nat_sync = 300\n')
    done = move(gateway, place, drives, "home", "--yes")
    assert done.exit_code == 4, done.output
    assert "node 5" in done.stderr
    assert "every drive stopped by itself" in done.stderr, "the fault comes after the proof"
    assert drives.stand_still()


@pytest.mark.slow
def test_where_another_command_cannot_begin_it_names_the_next_step_and_that_works(place, gateway, serve):
    """Two posts beside the hand: room for the proof, not for a small move of joint 1."""
    drives = serve()
    posts = "".join(
        f"  {{ min_m = [0.6, {low}, 0.9], max_m = [0.9, {high}, 1.3] }},\n"
        for low, high in ((0.16, 0.3), (-0.3, -0.16))
    )
    cell = place.variant("posts", ("keep_out = [\n", f"keep_out = [\n{posts}"))
    refused = gateway("check", cell, "--bus", drives.bus, "--move", "--yes")
    assert refused.exit_code == 5, refused.output
    assert "joint 1: no room for 0.15 rad (8.59 deg) in either direction" in said(refused)
    command = said(refused).split("To continue, move the arm (asks first): servo-gateway ")[1]
    assert command.startswith(f"move {cell} --bus {drives.bus} --to home")
    moved = gateway(*shlex.split(command), "--yes", "--override", 100)
    assert moved.exit_code == 0, moved.output
    assert "is at home, [" in said(moved)
    assert drives.stand_still()


@pytest.mark.slow
def test_from_outside_its_range_it_moves_inwards_first_and_the_check_says_so(place, gateway, serve):
    drives = serve()
    cell = narrow(place, "[0.1, 2.8]")
    check = gateway("check", cell, "--bus", drives.bus)
    assert check.exit_code == 7, check.output
    assert f"servo-gateway move {cell} --bus {drives.bus} --to home" in " ".join(check.stderr.split())
    moved = move(gateway, place, drives, "0.15,0,0,0,0,0", "--yes", "--override", 100, cell=cell)
    assert moved.exit_code == 0, moved.output
    assert "joint 1 is outside its range: it first moves slowly back into the range, to [0.120," in said(moved)
    assert "every drive stopped by itself" in moved.stderr, "proven on the way inwards"
    assert drives.stand_still()
