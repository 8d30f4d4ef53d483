"""An arm at rest whose payload may change from pose to pose, by an independent dynamics library (pinocchio)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from tests.data.arms import torque_of
from tests.data.moving_arm import World, true_arm

Payload = tuple[float, float, float, float] | None
BAND_NM = 0.4
#: What the links of the true arm differ from its model by.
CAD_ERROR = 0.02
AXES = range(1, 7)
HEADER = ",".join(["load", "pose", "time_s", *(f"q{i}_rad" for i in AXES), *(f"dir{i}" for i in AXES),
                   *(f"tau{i}_nm" for i in AXES)])  # fmt: skip


def readings(
    seed: int, rng: np.random.Generator, places: np.ndarray, payloads: Sequence[Payload]
) -> Iterator[tuple[int, float, np.ndarray]]:
    """Pose from 1, side and torque (6,) of each pose (k, 6) approached from both sides under its payload (k,)."""
    for pose, (place, payload) in enumerate(zip(places, payloads, strict=True), start=1):
        model = true_arm(np.random.default_rng(seed), World(payload=payload), CAD_ERROR)
        (gravity,) = torque_of(model, place[None])
        for side in (-1.0, 1.0):
            yield pose, side, gravity + side * BAND_NM + rng.normal(0.0, 0.02, 6)


def table_text(
    seed: int, loads: Sequence[tuple[str, Sequence[Payload]]], gain_std: float = 0.02, falls_by: float = 0.0
) -> str:
    """Measured table (CSV) of the same poses under each label, with the payload of each pose.

    The gains of the axes differ from 1 by `gain_std`, and all readings fall by `falls_by` over the run.
    """
    rng = np.random.default_rng([seed, 21])
    places = rng.uniform(-1.3, 1.3, (len(loads[0][1]), 6))
    gain = 1.0 + gain_std * rng.normal(size=6)
    count = 2 * sum(len(payloads) for _, payloads in loads)
    rows, number = [HEADER], 0
    for label, payloads in loads:
        for pose, side, torque in readings(seed, rng, places, payloads):
            number += 1
            read = (gain * (1.0 - falls_by * number / count) * torque).tolist()
            cells = [label, pose, 15.0 * number, *places[pose - 1].tolist(), *[int(side)] * 6, *read]
            rows.append(",".join(map(str, cells)))
    return "\n".join(rows) + "\n"
