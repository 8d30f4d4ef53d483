"""What fails beside the motion ends as the safety page states; `make chaos` plays all of it in both pacings."""

from __future__ import annotations

import pytest

from benchmarks.chaos.io_faults import play_again
from benchmarks.chaos.rig import rig


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "seed"), [("adapter unplugged", 0), ("lost SDO answers", 1)])
def test_a_fault_beside_the_motion_ends_as_stated(kind, seed):
    with rig() as drives:
        complaints, _ = play_again(drives, kind, seed)
    assert complaints == []
