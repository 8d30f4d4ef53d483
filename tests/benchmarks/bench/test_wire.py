"""The drives that the bus is measured against are admitted, enabled, and answer every SYNC."""

from __future__ import annotations

from benchmarks.bench.wire import _bus, _commands, _group
from benchmarks.bench.wire_responder import responder


def test_light_drives_answer_every_sync():
    with responder() as port, _bus(port) as bus, _group(bus, "lockstep", 0.004) as group:
        before, commands = group.statistics.incomplete, _commands(group)
        for _ in range(50):
            group.exchange(commands)
        assert group.statistics.incomplete == before
