"""What handing a SYNC to the page, and asking whether its button was pressed, costs the motion loop."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from benchmarks.live.rig import SMALL
from drives.values import DriveReading
from gateway.cell.config import load_cell
from gateway.data.visit import ArmSample
from gateway.live.drawing import shown_arm
from gateway.live.feed import Feed
from gateway.live.wire import ALIVE, ASK, MOST_BYTES, ShownCell, pair_of_sockets
from gateway.model.arm_model import arm_robot
from gateway.motion.observer import Observed, Observers
from gateway.motion.state import StateTracker
from gateway.motion.stops import StopDesk
from gateway.motion.workspace import workspace_of

SYNCS, PERIOD_S = 5000, 0.01


def figures(cell: Path = SMALL / "cell.toml") -> dict[str, dict]:
    """Time of one SYNC, six drives at 100 Hz, every row handed on."""
    loaded = load_cell(cell)
    config = loaded.cell.arm[0]
    workspace = workspace_of(config, arm_robot(loaded, config))
    here, there = pair_of_sockets()
    now_s = 0.0
    with here, there:
        feed = Feed(here, lambda: now_s)
        feed.show(ShownCell((shown_arm("main", workspace),), PERIOD_S), StateTracker("main", lambda _state: None))
        observers, desk = Observers(feed), StopDesk(feed.pressed)
        q_rad, torque_nm = np.zeros(6), np.ones(6)
        spent_us = []
        for sync in range(SYNCS):
            now_s += PERIOD_S
            readings = tuple(DriveReading(n, sync, 0x1237, 0, 0, 0, 0, 0.0, 0.0, 0.0, 0.0) for n in range(1, 7))
            sample = ArmSample(sync, now_s, q_rad, torque_nm, readings)
            began = time.perf_counter_ns()
            observed = Observed((sample,), (q_rad,), (torque_nm,))
            observers.notify(lambda observer, observed=observed: observer.sampled(observed))
            desk.look()
            spent_us.append(1e-3 * (time.perf_counter_ns() - began))
            while there.recv(MOST_BYTES) == ASK:
                there.send(ALIVE)
    return {
        "handing on a SYNC and asking for a stop, median": {
            "value": round(float(np.median(spent_us)), 1),
            "unit": "us",
        },
        "the same, 99 of 100": {"value": round(float(np.percentile(spent_us, 99)), 1), "unit": "us"},
    }
