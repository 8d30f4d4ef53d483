"""A bus that fails while the arm moves: reported in ten lines at most, the cause first, nothing twice."""

import re

import pytest

KILLED = "".join(f'[[fault]]\nkind = "node_killed"\nnode = {node}\nat_sync = 200\n' for node in range(1, 7))
KILLED_NODE = '[[fault]]\nkind = "node_killed"\nnode = 3\nat_sync = 200\n'


@pytest.mark.slow
@pytest.mark.parametrize(("fault", "named"), [(KILLED, "nodes 1 to 6"), (KILLED_NODE, "node 3")])
def test_a_failure_is_reported_once_and_shortly(place, gateway, serve, fast_arm, fault, named):
    drives = fast_arm(serve(fault=fault))
    done = gateway("record", place.cell, "--load", "none", "-o", place.run, "--bus", drives.bus, "--yes", "-q")
    assert done.exit_code == 4, done.output
    lines = done.stderr.splitlines()
    assert lines[0].startswith("error: ")
    assert len(lines) <= 10
    assert named in done.stderr
    assert len(done.stderr) < 10 * 140
    parts = [part.strip() for part in re.split(r"[;,]|\(\d\)|: ", done.stderr) if len(part) > 30]
    assert len(parts) == len(set(parts)), parts
    assert "defect" not in done.stderr
    assert drives.stand_still()


def test_nothing_is_kept_without_confirmation(place, gateway, serve):
    drives = serve()
    done = gateway("record", place.cell, "--load", "none", "-o", place.run, "--bus", drives.bus, input="n\n")
    assert done.exit_code == 130
    assert "nothing has moved" in done.stderr
    assert "is kept" not in done.stderr
    assert not place.run.exists()
