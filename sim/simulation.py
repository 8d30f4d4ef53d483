"""Simulation of the drives of a cell: reads the files and builds one server per bus."""

from __future__ import annotations

import json
import threading
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import can

from sim.build_errors import with_build_errors
from sim.cellfile import PACINGS, CellBus, CellFileError, CellSpec, parse_bus_spec, read_cell, read_payloads, read_toml
from sim.effects import apply_effects
from sim.fault import Fault
from sim.faults import KINDS, FaultError, act, read_faults
from sim.multicast import QuietMulticastBus
from sim.nominal import plant_of
from sim.offline import point_jacobian
from sim.pair.cell import pair_units
from sim.pair.two_arms import TwoArms
from sim.plant import Payload
from sim.server import ArmUnit, BusServer, Unit, can_be_waited_for, serve_together
from sim.timing_record import TimingRecord
from sim.undeclared import draw_undeclared
from sim.wire_faults import FaultyWire

NOISE_SEED = 1
#: Between the seeds of two arms of one cell.
ARM_SEED = 100_000


class SimulationBusError(OSError):
    """The bus cannot be opened."""


class GripError(ValueError):
    """The cell has no grippers."""


@dataclass(frozen=True, slots=True)
class ServeOptions:
    """Options of `servo-sim serve` besides the cell.

    Attributes
    ----------
    bus : INTERFACE:CHANNEL[,key=value]... in place of the cell's bus; with several buses NAME=SPEC;NAME=SPEC
    payload : file of loads that can be mounted on the flange
    undeclared : file of undeclared effects; `build_errors = SEED` in it draws build errors beside
    seed : draw build errors, and an effect, none or two instead
    fault : faults, each [NODE:]NAME or a scenario file (`sim.faults`)
    truth : where the truth is written at start
    pacing : "lockstep" or "real" in place of every bus's own
    posture : joint angles J1,J2,.. [rad] at which the arm of a cell with one arm starts, in place of zeros
    unbuffered : in real time, each target is taken over when it arrives instead of at a tick of the drive's own clock
    timing : where frames and motion of the drives are written at the end (`sim.timing_record`)
    noise_seed : seed of noise and of the scatter of friction in place of `seed`; None = `seed`, or always the same
    """

    bus: str | None = None
    payload: Path | None = None
    undeclared: Path | None = None
    seed: int | None = None
    fault: tuple[str | Path, ...] = ()
    truth: Path | None = None
    pacing: str | None = None
    posture: str | None = None
    unbuffered: bool = False
    timing: Path | None = None
    noise_seed: int | None = None


class Simulation:
    """Simulated drives, ready to run.

    Parameters
    ----------
    cell_path : cell file
    options : see `ServeOptions`
    **pair : of two arms, what to change about them (`sim.pair.cell.pair_units`)

    Attributes
    ----------
    cell : what was read
    loads : by label
    effects : what is built in; where there are several arms, each effect names its `arm`
    specs : the buses, by name
    servers : one for each bus
    records : of frames and motion, one for each bus, if wanted
    """

    def __init__(self, cell_path: Path, options: ServeOptions, **pair: Any) -> None:
        self.cell = _started(read_cell(cell_path), options)
        self.loads: dict[str, Payload] = read_payloads(options.payload) if options.payload else {}
        self.effects, self._build_seed = _undeclared(options)
        self._options = options
        faults = [fault for wanted in options.fault for fault in read_faults(wanted)]
        nodes = sorted({axis.node_id for arm in self.cell.arms for axis in arm.axes})
        if unknown := [fault for fault in faults if fault.node not in (0, *nodes)]:
            raise FaultError(f"fault '{unknown[0].kind}': no drive has node {unknown[0].node} (drives: {nodes})")
        self._pair: TwoArms | None = None
        units: dict[str, Unit] = {}
        if self.cell.pair is None:
            units |= {arm.name: self._unit(index) for index, arm in enumerate(self.cell.arms)}
        else:
            units |= pair_units(self.cell, options.seed, **pair)
            self._pair = next(iter(units.values())).world
        self.specs = _bus_specs(self.cell, options.bus)
        self.servers: list[BusServer] = []
        if options.truth is not None:
            options.truth.write_text(json.dumps(self.truth(), indent=2) + "\n", encoding="utf-8")
        with ExitStack() as opened:
            for name, spec in self.specs.items():
                arms = [units[arm.name] for arm in self.cell.arms if arm.bus == name]
                if arms:
                    self.servers.append(_server(spec, arms, faults, opened))
            opened.pop_all()
        self.records = [] if options.timing is None else [TimingRecord(server) for server in self.servers]
        for server in self.servers if options.unbuffered else ():
            for drive in server.drives:
                drive.motion.buffered = False

    def _unit(self, index: int) -> ArmUnit:
        arm = self.cell.arms[index]
        plant = plant_of(arm)
        seed = self._options.seed
        if self._build_seed is not None:
            plant = with_build_errors(plant, arm.chain, self._build_seed)
        effects = self.effects
        if seed is not None:
            effects = draw_undeclared(arm, plant, self.loads, seed + ARM_SEED * index)
            named = {"arm": arm.name} if len(self.cell.arms) > 1 else {}
            self.effects = [*self.effects, *(effect | named for effect in effects)]
        plant = apply_effects(plant, effects, point_jacobian(arm.chain), self._options.undeclared)
        drawn = seed if self._options.noise_seed is None else self._options.noise_seed
        noise = (NOISE_SEED if drawn is None else drawn) + 1000 * index
        return ArmUnit(arm, plant, self.cell.buses[arm.bus].sync_period_s, noise)

    @property
    def arms(self) -> list[Unit]:
        """All arms, in the order of the cell file."""
        found = {arm.name: arm for server in self.servers for arm in server.arms}
        return [found[arm.name] for arm in self.cell.arms]

    def truth(self) -> dict[str, Any]:
        """Return the truth for the scoring: loads and effects."""
        loads = [
            {"label": load.label, "mass_kg": load.mass_kg, "com_m": [float(value) for value in load.com_m]}
            for load in self.loads.values()
        ]
        drawn = {} if self._pair is None else {"pair": self._pair.undeclared}
        return {"loads": loads, "effects": self.effects} | drawn

    def mount(self, label: str) -> None:
        """Mount a load on the flange (`none`: remove it); return when it is mounted. Call from outside the servers.

        `load` is an alias of the only load of the file.

        Raises
        ------
        KeyError : no such load
        ValueError : the arms are a pair, which holds its workpiece and nothing else
        TimeoutError : as `BusServer.mount`
        """
        if label == "load" and label not in self.loads and len(self.loads) == 1:
            label = next(iter(self.loads))
        payload = Payload() if label == "none" else self.loads[label]
        for server in self.servers:
            for unit in server.arms:
                if self._pair is not None:
                    raise ValueError(f"arm {unit.name} holds the workpiece; load {label} cannot be mounted on it")
                server.mount(unit, payload)

    def grip(self, open: bool) -> None:
        """Open or close both grippers of a pair; closing grips the part afresh, free of force, where the hands are.

        Raises
        ------
        GripError : there is no pair, or it holds no part
        """
        if self._pair is None:
            raise GripError(f"cell {self.cell.name} has no pair; there are no grippers")
        if not self._pair.touching:
            raise GripError(f"the hands of cell {self.cell.name} keep a distance; there is no part to grip")
        self._pair.open_grippers() if open else self._pair.close_grippers()

    def stop(self) -> None:
        """End all servers."""
        for server in self.servers:
            server.stop()

    def run(self) -> None:
        """Serve all buses until `stop`: one plant on several of them in this thread, else the first one."""
        together = self.cell.pair is not None and all(server.real for server in self.servers)
        if together and all(can_be_waited_for(server.bus) for server in self.servers):
            serve_together(self.servers)
            return
        others = [threading.Thread(target=server.run, name="sim-bus") for server in self.servers[1:]]
        for thread in others:
            thread.start()
        try:
            self.servers[0].run()
        finally:
            self.stop()
            for thread in others:
                thread.join()

    def close(self) -> None:
        """Release the physics engines."""
        for record in self.records:
            record.write(cast(Path, self._options.timing))
        for server in self.servers:
            for unit in server.arms:
                unit.world.close()


def _started(cell: CellSpec, options: ServeOptions) -> CellSpec:
    """Return the cell with the pacing and the start posture of the options."""
    if options.pacing is not None:
        if options.pacing not in PACINGS:
            raise CellFileError(f"pacing '{options.pacing}' is not known; it is {' or '.join(PACINGS)}.")
        cell = replace(cell, buses={name: replace(bus, pacing=options.pacing) for name, bus in cell.buses.items()})
    if options.posture is not None:
        arm, angles = cell.arms[0], tuple(map(float, options.posture.split(",")))
        limits = [axis.position_limit_rad for axis in arm.axes]
        inside = len(angles) == len(limits) and all(low <= q <= up for q, (low, up) in zip(angles, limits, strict=True))
        if len(cell.arms) > 1 or not inside:
            need = ", ".join(f"{low:g} to {up:g}" for low, up in limits)
            raise CellFileError(f"--posture {options.posture}: give one angle a joint of the only arm, {need} rad.")
        cell = replace(cell, arms=(replace(arm, start_rad=angles),))
    return cell


def _undeclared(options: ServeOptions) -> tuple[list[dict[str, Any]], int | None]:
    """Return the effects of the file, and the seed of the build errors."""
    path = options.undeclared
    if path is None:
        return [], options.seed
    table = read_toml(path)
    effects, errors = table.get("effect", []), table.get("build_errors", options.seed)
    if not isinstance(effects, list) or not all(isinstance(effect, dict) for effect in effects):
        raise CellFileError(f"{path}: effects are [[effect]] tables with name, joints and parameters.")
    if errors is not None and (not isinstance(errors, int) or isinstance(errors, bool) or errors < 0):
        raise CellFileError(f"{path}: build_errors is the seed of the links' errors, a number from 0, got {errors!r}.")
    return effects, errors


def _bus_specs(cell: CellSpec, stated: str | None) -> dict[str, CellBus]:
    """Bus of each name, the ones on the command line in place of the file's."""
    specs = dict(cell.buses)
    if stated is None:
        return specs
    if len(specs) == 1 and ";" not in stated:
        name = next(iter(specs))
        return {name: parse_bus_spec(stated, specs[name])}
    for part in stated.split(";"):
        name, _, text = part.partition("=")
        if name not in specs:
            raise CellFileError(f"--bus '{part}': several buses are NAME=SPEC;NAME=SPEC, names of the cell.")
        specs[name] = parse_bus_spec(text, specs[name])
    return specs


def open_bus(spec: CellBus) -> can.BusABC | QuietMulticastBus:
    """Open a python-can bus; one of multicast stays on this computer unless the options give it a hop.

    Raises
    ------
    BusError : python-can cannot open it
    """
    options: dict[str, Any] = dict(spec.options)
    try:
        if spec.interface == "udp_multicast":
            return QuietMulticastBus(spec.channel, **{"hop_limit": 0} | options)
        return can.Bus(interface=spec.interface, channel=spec.channel, bitrate=spec.bitrate_bit_s, **options)
    except (can.CanError, OSError, TypeError, ValueError, ImportError) as error:
        raise SimulationBusError(f"bus {spec.interface}:{spec.channel} cannot be opened: {error}") from error


def _server(spec: CellBus, arms: list[Unit], faults: list[Fault], opened: ExitStack) -> BusServer:
    bus: Any = open_bus(spec)
    opened.callback(bus.shutdown)
    if not faults:
        return BusServer(bus, arms, spec.sync_period_s, spec.pacing)
    wire = FaultyWire(bus, KINDS)
    wire.period_s, wire.real = spec.sync_period_s, spec.pacing == "real"
    server = BusServer(wire, arms, spec.sync_period_s, spec.pacing)
    wire.act = lambda fault: act(server.drives, fault)
    for fault in faults:
        wire.arm(fault)
    return server
