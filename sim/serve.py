"""Serve the simulated drives of a cell on their buses: for the command line, and as a context manager for tests."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from sim.simulation import GripError, ServeOptions, Simulation, SimulationBusError, open_bus

MULTICAST_GROUP = "239.74.163.2"
READY = "ready"
START_TIMEOUT_S = 60.0


def serve(cell_path: Path, options: ServeOptions, say: Callable[[str], None]) -> None:
    """Serve a cell until SIGINT or SIGTERM; lines on stdin mount loads.

    Parameters
    ----------
    cell_path : cell file
    options : see `ServeOptions`
    say : called with each line for the user

    Raises
    ------
    CellFileError, UrdfError, EffectError, FaultError : a file cannot be used
    BusError : the bus cannot be opened
    """
    simulation = Simulation(cell_path, options)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda _number, _frame: simulation.stop())
    reader = threading.Thread(target=_obey, args=(simulation, sys.stdin, say), name="sim-stdin", daemon=True)
    reader.start()
    buses = ", ".join(f"{bus.interface}:{bus.channel}" for bus in simulation.specs.values())
    loads = ", ".join(simulation.loads) or "none given"
    count = sum(len(arm.drives) for arm in simulation.arms)
    say(f"{READY}: {count} drives of cell {simulation.cell.name} on {buses}; loads: {loads}{_assumed(simulation)}")
    try:
        simulation.run()
    finally:
        simulation.close()


def _assumed(simulation: Simulation) -> str:
    """Return the message about arms with assumed links."""
    reported = ""
    for arm in simulation.cell.arms:
        if arm.assumed_links:
            masses = ", ".join(f"{body.mass_kg:.3g}" for body in arm.chain.bodies if body is not None)
            reported += f"; arm {arm.name} has no URDF: links of {masses} kg are assumed"
    return reported


def _obey(simulation: Simulation, lines: IO[str], say: Callable[[str], None]) -> None:
    """Lines of stdin: `payload LABEL`, `payload none`, `grip open`, `grip closed`, `quit`."""
    for line in lines:
        words = line.split()
        if words == ["quit"]:
            simulation.stop()
        elif len(words) == 2 and words[0] == "payload":
            try:
                simulation.mount(words[1])
                say(f"payload {words[1]} on the flange")
            except KeyError:
                known = ", ".join(["none", *simulation.loads])
                say(f"payload {words[1]} is not known; known are {known}")
            except ValueError as error:
                say(str(error))
        elif words in (["grip", "open"], ["grip", "closed"]):
            try:
                simulation.grip(open=words[1] == "open")
                say(f"grippers {words[1]}")
            except GripError as error:
                say(str(error))
        elif words:
            say("not understood; say: payload LABEL, payload none, grip open, grip closed, quit")


# -------------------------------------------------------------------------------------------------------- for tests


class RunningSimulation:
    """Handle of drives that run.

    Attributes
    ----------
    bus : what a master has to open, INTERFACE:CHANNEL[,key=value]...
    simulation : the simulation itself where it runs in this process, else None
    """

    def __init__(self, bus: str, simulation: Simulation | None, process: subprocess.Popen[str] | None) -> None:
        self.bus, self.simulation, self._process = bus, simulation, process

    def grip(self, open: bool) -> None:
        """Open or close the grippers of a pair; returns when they are."""
        if self.simulation is not None:
            self.simulation.grip(open)
            return
        answer = self._ask(f"grip {'open' if open else 'closed'}")
        if not answer.startswith("grippers"):
            raise GripError(answer)

    def _ask(self, line: str) -> str:
        if self._process is None or self._process.stdin is None or self._process.stdout is None:
            raise RuntimeError("the simulator cannot be spoken to")
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()
        return self._process.stdout.readline().strip()

    def mount(self, label: str) -> None:
        """Mount a load on the flange; return when it is mounted."""
        if self.simulation is not None:
            self.simulation.mount(label)
            return
        answer = self._ask(f"payload {label}")
        if "on the flange" not in answer:
            raise KeyError(answer)


@contextmanager
def running(cell_path: Path, bus: str | None = None, **options: Any) -> Generator[RunningSimulation]:
    """Simulated drives for the time of a `with` block: in a thread on `virtual`, else in a process of their own.

    Parameters
    ----------
    cell_path : cell file
    bus : INTERFACE:CHANNEL[,key=value]...; None = a free udp_multicast port
    **options : further fields of `ServeOptions`
    """
    spec = bus or free_bus()
    stated = ServeOptions(bus=spec, **options)
    with _in_thread(cell_path, stated) if spec.startswith("virtual:") else _in_process(cell_path, stated) as handle:
        yield handle


@contextmanager
def _in_thread(cell_path: Path, options: ServeOptions) -> Generator[RunningSimulation]:
    simulation = Simulation(cell_path, options)
    thread = threading.Thread(target=simulation.run, name="sim-drives")
    thread.start()
    try:
        yield RunningSimulation(options.bus or "", simulation, None)
    finally:
        simulation.stop()
        thread.join()
        simulation.close()


def command(cell_path: Path, options: ServeOptions) -> list[str]:
    """Command line of `servo-sim serve` with the same options."""
    words = [sys.executable, "-m", "sim", "serve", str(cell_path)]
    pairs: Mapping[str, object] = {
        "--bus": options.bus,
        "--payload": options.payload,
        "--undeclared": options.undeclared,
        "--seed": options.seed,
        "--truth": options.truth,
        "--pacing": options.pacing,
        "--timing": options.timing,
    }
    for key, value in pairs.items():
        if value is not None:
            words += [key, str(value)]
    for wanted in options.fault:
        words += ["--fault", str(wanted)]
    return [*words, "--unbuffered"] if options.unbuffered else words


@contextmanager
def _in_process(cell_path: Path, options: ServeOptions) -> Generator[RunningSimulation]:
    process = subprocess.Popen(
        command(cell_path, options), stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        wait_until_ready(process)
        yield RunningSimulation(options.bus or "", None, process)
    finally:
        process.terminate()
        try:
            process.communicate(timeout=10.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()


def wait_until_ready(process: subprocess.Popen[str]) -> str:
    """The ready line of a simulator that was just started.

    Raises
    ------
    RuntimeError : it ended, or had no output for a minute; its own message is passed on
    """
    killer = threading.Timer(START_TIMEOUT_S, process.kill)
    killer.start()
    try:
        line = process.stdout.readline() if process.stdout is not None else ""
    finally:
        killer.cancel()
        killer.join()
    if not line.startswith(READY):
        process.kill()
        errors = process.communicate()[1] or ""
        raise RuntimeError(f"the simulator did not start: {line}{errors}".strip())
    return line


def free_bus() -> str:
    """Return a udp_multicast bus on an unused port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        port = probe.getsockname()[1]
    return f"udp_multicast:{MULTICAST_GROUP},port={port}"


__all__ = [
    "SimulationBusError",
    "RunningSimulation",
    "ServeOptions",
    "Simulation",
    "command",
    "free_bus",
    "open_bus",
    "running",
    "serve",
    "wait_until_ready",
]
