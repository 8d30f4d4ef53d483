"""Run drives on a bus: python -m tests.support.independent_drive --bus SPEC --node 1,2,3,4,5,6 --variant zero-extended.

Prints `ready`. Commands come as lines: `load MASS X Y Z` and `load none` attach and remove a load at the last link
[kg, m]. `stops` prints the joint speeds of each axis at which quick stops began [rad/s], as JSON. `read NODE INDEX
SUB` prints the value of an object. The process ends with its standard input.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import threading
from collections import deque
from contextlib import suppress

import can
from durand import set_scheduler

from tests.support.independent_drive.drive import VARIANTS, Drive
from tests.support.independent_drive.network import NodeNetwork, Timers
from tests.support.independent_drive.plant import Arm

SYNC = 0x080
#: Actual values of an arm under power are refreshed as often where no SYNC comes [s].
REFRESH_S = 0.01
#: The same of an arm in its brakes [s].
IDLE_S = 0.1


def open_bus(spec: str) -> can.BusABC:
    """Bus of INTERFACE:CHANNEL[,key=value]..."""
    interface, _, rest = spec.partition(":")
    channel, *pairs = rest.split(",")
    options = {key: int(value, 0) for key, _, value in (pair.partition("=") for pair in pairs)}
    return can.Bus(interface=interface, channel=channel, **options)


class Process:
    """The loop of all drives: frames, timers, commands."""

    def __init__(self, bus: can.BusABC, nodes: list[int], variant: str, angles: list[float]) -> None:
        self._bus, self._timers = bus, Timers()
        set_scheduler(self._timers)
        self.arm = Arm(angles)
        self._nodes, kind = nodes, VARIANTS[variant]
        self._drives = [
            Drive(NodeNetwork(bus, node, kind.answer), node, self.arm, number, kind)
            for number, node in enumerate(nodes)
        ]
        self._synced = self._was_live = False
        self._timers.add(REFRESH_S, self._refresh)

    def _refresh(self) -> None:
        live = any(axis.powered or not axis.brake_closed for axis in self.arm.axes)
        self.arm.advance(self._period_s)
        if not self._synced and (live or self._was_live):
            self._measure()
        self._synced, self._was_live = False, live
        self._timers.add(REFRESH_S if live else IDLE_S, self._refresh)

    @property
    def _period_s(self) -> float:
        return self._drives[0].period_s

    def _measure(self) -> None:
        for drive in self._drives:
            drive.measure()

    def take(self, frame: can.Message) -> None:
        """Hand a frame to every drive that listens to it.

        With a SYNC the actual values are sampled first, then sent, and what the RPDOs before it held becomes effective.
        """
        if frame.is_error_frame or frame.is_remote_frame or frame.is_extended_id:
            return
        cob_id, data = frame.arbitration_id, bytes(frame.data)
        if cob_id == SYNC:
            self._synced = True
            self.arm.sync(self._period_s)
            self._measure()
        for drive in self._drives:
            callback = drive.network.callbacks.get(cob_id)
            if callback is not None:
                callback(cob_id, data)
                drive.act()

    def run(self, commands: deque[str], ended: threading.Event) -> None:
        """Until the commands end."""
        while not ended.is_set():
            while commands:
                self._obey(commands.popleft())
            frame = self._bus.recv(self._timers.run_due())
            if frame is not None:
                self.take(frame)

    def _obey(self, line: str) -> None:
        word, *values = line.split()
        answer = line
        if word == "stops":
            speeds = [[round(speed, 5) for speed in drive.stop_speeds] for drive in self._drives]
            answer = f"stops {json.dumps(speeds)}"
        elif word == "read":
            node, index, sub = (int(value, 0) for value in values)
            answer = f"read {self._drives[self._nodes.index(node)].od.read(index, sub)}"
        elif values == ["none"]:
            self.arm.load = None
        else:
            mass, x, y, z = map(float, values)
            self.arm.load = (mass, (x, y, z))
        print(answer, flush=True)


def main() -> None:
    """Parse the command line and run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bus", required=True, help="INTERFACE:CHANNEL[,key=value]...")
    parser.add_argument("--node", required=True, help="node ids of the axes in their order, comma separated")
    parser.add_argument("--variant", choices=VARIANTS, default="zero-extended")
    parser.add_argument("--angles", default="0,-0.2,0.4,0,0.3,0", help="joint angles at the beginning [rad]")
    arguments = parser.parse_args()
    nodes = [int(text) for text in arguments.node.split(",")]
    angles = [float(text) for text in arguments.angles.split(",")]
    commands: deque[str] = deque()
    ended = threading.Event()

    def listen() -> None:
        for line in sys.stdin:
            commands.append(line.strip())
        ended.set()

    if os.environ.get("SERVO_GATEWAY_IN_VM") != "1":  # an emulated processor would have time for nothing else
        with suppress(PermissionError):  # a drive has a processor of its own
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(20))
    with open_bus(arguments.bus) as bus:
        process = Process(bus, nodes, arguments.variant, angles)
        threading.Thread(target=listen, daemon=True).start()
        print("ready", flush=True)
        process.run(commands, ended)


if __name__ == "__main__":
    main()
