"""Serve the simulated drives of a cell on their buses: for the command line, and as a context manager for tests."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Generator, Iterable
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

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
    threading.Thread(target=obey, args=(simulation, sys.stdin, say), name="sim-stdin", daemon=True).start()
    buses = ", ".join(f"{bus.interface}:{bus.channel}" for bus in simulation.specs.values())
    loads = ", ".join(simulation.loads) or "none given"
    count = sum(len(arm.drives) for arm in simulation.arms)
    said = f"{READY}: {count} drives of cell {simulation.cell.name} on {buses}; loads: {loads}"
    for arm in simulation.cell.arms:
        if arm.assumed_links:
            masses = ", ".join(f"{body.mass_kg:.3g}" for body in arm.chain.bodies if body is not None)
            said += f"; arm {arm.name} has no URDF: links of {masses} kg are assumed"
    say(said)
    try:
        simulation.run()
    finally:
        simulation.close()


def obey(simulation: Simulation, lines: Iterable[str], say: Callable[[str], None]) -> None:
    """Lines of stdin: `payload LABEL`, `payload none`, `grip open`, `grip closed`, `quit`; each is answered but `quit`.

    Parameters
    ----------
    simulation : Simulation that is served by other threads
    lines : what is typed
    say : called with each answer
    """
    for line in lines:
        match line.split():
            case ["quit"]:
                simulation.stop()
            case ["payload", label]:
                try:
                    simulation.mount(label)
                    say(f"payload {label} on the flange")
                except KeyError:
                    say(f"payload {label} is not known; known are {', '.join(['none', *simulation.loads])}")
                except (ValueError, TimeoutError) as error:
                    say(str(error))
            case ["grip", "open" | "closed" as to]:
                try:
                    simulation.grip(open=to == "open")
                    say(f"grippers {to}")
                except GripError as error:
                    say(str(error))
            case []:
                pass
            case _:
                say("not understood; say: payload LABEL, payload none, grip open, grip closed, quit")


# -------------------------------------------------------------------------------------------------------- for tests


@dataclass(frozen=True, slots=True)
class RunningSimulation:
    """Handle of drives that run.

    Attributes
    ----------
    bus : what a master has to open, INTERFACE:CHANNEL[,key=value]...
    ask : called with a line of stdin, returns the answer to it
    ready : line of a process that is ready
    simulation : the simulation itself where it runs in this process, else None
    """

    bus: str
    ask: Callable[[str], str]
    ready: str = READY
    simulation: Simulation | None = None

    def grip(self, open: bool) -> None:
        """Open or close the grippers of a pair; returns when they are."""
        answer = self.ask(f"grip {'open' if open else 'closed'}")
        if not answer.startswith("grippers"):
            raise GripError(answer)

    def mount(self, label: str) -> None:
        """Mount a load on the flange; return when it is mounted."""
        answer = self.ask(f"payload {label}")
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

    def ask(line: str) -> str:
        said: list[str] = []
        obey(simulation, [line], said.append)
        return "".join(said)

    thread.start()
    try:
        yield RunningSimulation(options.bus or "", ask, simulation=simulation)
    finally:
        simulation.stop()
        thread.join()
        simulation.close()


def command(cell_path: Path, options: ServeOptions) -> list[str]:
    """Command line of `servo-sim serve` with the same options."""
    words = [sys.executable, "-m", "sim", "serve", str(cell_path)]
    for key, value in asdict(options).items():
        for one in value if isinstance(value, tuple) else (value,):
            option = "--" + key.replace("_", "-")
            if one is True:
                words.append(option)
            elif one is not None and one is not False:
                words += [option, str(one)]
    return words


@contextmanager
def _in_process(cell_path: Path, options: ServeOptions) -> Generator[RunningSimulation]:
    process = subprocess.Popen(
        command(cell_path, options), stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )

    def ask(line: str) -> str:
        if process.stdin is None or process.stdout is None:
            raise RuntimeError("the simulator cannot be spoken to")
        process.stdin.write(line + "\n")
        process.stdin.flush()
        return process.stdout.readline().strip()

    try:
        yield RunningSimulation(options.bus or "", ask, wait_until_ready(process).rstrip())
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
