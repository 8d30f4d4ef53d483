"""A pair whose drive fails the pre-flight check is not brought up: neither arm is written to or enabled."""

from __future__ import annotations

import threading

import pytest

from benchmarks.pair.bus_rig import bus_spec, simulated
from gateway.errors import FindingFailed
from gateway.pair.pair_cell import load_pair
from gateway.pair.session import open_link


def test_a_turned_polarity_of_the_slave_refuses_both_arms() -> None:
    with simulated(None) as (simulation, path, buses):
        thread = threading.Thread(target=simulation.run, name="pair-sim")
        thread.start()
        try:
            simulation.servers[1].drives[1].store.values[0x607E, 0] = 0xC0
            cell = load_pair(path, bus_spec(buses))
            with pytest.raises(FindingFailed, match=r"not moved: J2 node \d+:607E"), open_link(cell):
                pass
            assert [server.sync_count for server in simulation.servers] == [0, 0]
        finally:
            simulation.stop()
            thread.join()
