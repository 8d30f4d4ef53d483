"""Distance sensors of a cell: devices and channels, plausibility check, and conditions that stop both arms."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from drives.instrument import InstrumentSetup
from gateway.cell.config_pair import DistanceConfig, PairConfig
from gateway.data.visit import ArmSample
from gateway.motion.reactions import ARM_RULES
from gateway.pair.distance import DistanceEstimator, DistanceSensors
from gateway.pair.transform import Floats, inverse

#: Largest difference between sensors and the hands' motion: share of it, and at least [m].
SENSOR_MISMATCH, LEAST_MOVED_M = 0.3, 1.5e-4


@dataclass(frozen=True, slots=True, eq=False)
class GapLayout:
    """Distance sensors of a pair.

    Attributes
    ----------
    config : DistanceConfig
    arm : int
        On whose bus the device is, 0 master, 1 slave.
    estimator : DistanceEstimator
    """

    config: DistanceConfig
    arm: int
    estimator: DistanceEstimator

    @property
    def limit_m(self) -> float:
        """Return the smallest deviation of a distance from the demanded one that stops both arms [m]."""
        low, high = self.config.range_m
        return min(min(one.gap_m - low, high - one.gap_m) for one in self.config.channel)


def gap_layout(config: DistanceConfig, arm: int, wanted: Floats) -> GapLayout:
    """Return the sensors of a cell file, each at its demanded gap at the demanded relation (4, 4).

    Raises
    ------
    ConfigError
        The sensors do not determine the components that shall be corrected.
    ConfigurationRefused
        Too many channels for one device.
    """
    origin = np.array([one.at_m for one in config.channel])
    beam = np.array([np.array(one.beam) / np.linalg.norm(one.beam) for one in config.channel])
    gap = np.array([[one.gap_m] for one in config.channel])
    on_master = np.array([one.on == "master" for one in config.channel])
    # a plane is fixed to the other gripper: the beam ends on it at the demanded relation
    spots = [
        _moved(inverse(wanted) if master else wanted, start, along)
        for master, start, along in zip(on_master.tolist(), origin + gap * beam, -beam, strict=True)
    ]
    point, normal = np.array([spot for spot, _ in spots]), np.array([turned for _, turned in spots])
    estimator = DistanceEstimator(DistanceSensors(origin, beam, point, normal, on_master), wanted, config.components)
    _instrument(config).plans()
    return GapLayout(config, arm, estimator)


def instruments_on(bus: str, pair: PairConfig | None) -> tuple[InstrumentSetup, ...]:
    """Return the measuring devices of a cell on a bus, without the meaning of their channels."""
    distance = None if pair is None else pair.distance
    return () if distance is None or distance.bus != bus else (_instrument(distance),)


def _instrument(config: DistanceConfig) -> InstrumentSetup:
    return InstrumentSetup(
        config.node_id,
        config.object,
        config.type,
        tuple(one.subindex for one in config.channel),
        config.lsb_m,
        status_index=config.status_object,
    )


def _moved(relation: Floats, point: Floats, direction: Floats) -> tuple[Floats, Floats]:
    return relation[:3, :3] @ point + relation[:3, 3], relation[:3, :3] @ direction


class SensorCheck:
    """Check that each sensor follows small movements of the hands measured by the encoders.

    Where the hands are is not known as well as the sensors measure; how far they have moved since is, as geometry is
    off by the same as before.

    Parameters
    ----------
    layout : GapLayout
    """

    def __init__(self, layout: GapLayout) -> None:
        self._layout = layout
        self._began: tuple[Floats, Floats] | None = None
        self._off = 0

    def take(self, readings_m: Floats | None, relation: Floats) -> str:
        """Take in the distances (n,) [m] of a SYNC and the relation (4, 4) of both hands at it.

        Returns
        -------
        str
            Why both arms must stop, "" = they need not.
        """
        if readings_m is None:
            return ""
        expected = self._layout.estimator.sensors.readings(relation)
        if self._began is None:
            self._began = readings_m, expected
            return ""
        moved, expected = readings_m - self._began[0], expected - self._began[1]
        size = float(np.linalg.norm(expected))
        self._off = (
            self._off + 1 if np.linalg.norm(moved - expected) > max(SENSOR_MISMATCH * size, LEAST_MOVED_M) else 0
        )
        return self._named(moved, expected) if self._off >= ARM_RULES["sensors"].count else ""

    def _named(self, moved: Floats, expected: Floats) -> str:
        number = [one.subindex for one in self._layout.config.channel]
        rests = {
            swap: float(np.linalg.norm(_exchanged(moved, swap) - expected))
            for swap in itertools.combinations(range(len(moved)), 2)
        }
        best = min(rests, key=lambda swap: rests[swap], default=None)
        worst = int(np.argmax(np.abs(moved - expected)))
        if best is not None and rests[best] < float(np.linalg.norm(np.delete(moved - expected, worst))):
            one, other = (number[i] for i in best)
            why = (
                f"sensors {one} and {other} are swapped: each changes as expected of the other; exchange their channels"
            )
        else:
            why = (
                f"sensor {number[worst]} moved by {1e3 * moved[worst]:.2f} mm where the hand motion gives"
                f" {1e3 * expected[worst]:.2f} mm: check its place, direction and wiring"
            )
        return f"distance {why}"


def _exchanged(values: Floats, swap: tuple[int, int]) -> Floats:
    out = values.copy()
    out[list(swap)] = values[list(swap[::-1])]
    return out


@dataclass(frozen=True, slots=True)
class GapTrouble:
    """Reason to stop both arms; `urgent` if the hands may touch before a stop along the path has ended."""

    why: str
    urgent: bool


class GapWatch:
    """Monitors the distances of every SYNC; no older value is used.

    Parameters
    ----------
    layout : GapLayout

    Attributes
    ----------
    readings_m : distances (n,) of the last SYNC [m], None = it brought no value
    """

    def __init__(self, layout: GapLayout) -> None:
        self.layout = layout
        self.readings_m: Floats | None = None
        self._missing = 0

    def take(self, samples: tuple[ArmSample, ...]) -> GapTrouble | None:
        """Process the samples of both buses at a SYNC; return why both arms must stop, None = continue."""
        config = self.layout.config
        reading = samples[self.layout.arm].instruments[0]
        self.readings_m = None
        values = () if reading is None else reading.values
        known = [(one, value) for one, value in zip(config.channel, values, strict=False) if value is not None]
        low, high = config.range_m
        for channel, value in known:
            if not low <= value <= high:
                return GapTrouble(
                    f"distance sensor {channel.subindex} measures {1e3 * value:.2f} mm, its range is {1e3 * low:g} to"
                    f" {1e3 * high:g} mm; move the arms apart, then check grasps and bases",
                    urgent=True,
                )
        if len(known) == len(config.channel):
            self.readings_m = np.array([value for _, value in known])
            self._missing = 0
            return None
        self._missing += 1
        if self._missing < config.missing_cycles:
            return None
        without = [one.subindex for one, value in zip(config.channel, values, strict=False) if value is None]
        why = f"sensor {without[0]} reports no valid value" if without else "its frames are missing or delayed"
        return GapTrouble(
            f"node {config.node_id} on bus '{config.bus}': no distances for {self._missing} cycles, {why};"
            " check the measuring device",
            urgent=False,
        )
