"""Figures of one cycle of the numpy tier."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gateway.pair.path import PairPath
from tests.support.pair.model_rig import LIMIT_N, SYNC_S, Run

Array = NDArray[np.float64]
OSCILLATION_HZ = 5.0


def oscillation(internal: Array, dt_s: float = SYNC_S) -> float:
    """Share of the energy of the internal force (M, 3 or 6) above 5 Hz."""
    force = internal[:, :3] - internal[:, :3].mean(axis=0)
    power = (np.abs(np.fft.rfft(force, axis=0)) ** 2).sum(axis=1)
    return float(power[np.fft.rfftfreq(len(force), dt_s) > OSCILLATION_HZ].sum() / max(power.sum(), 1e-300))


def cycle_rows(run: Run, path: PairPath, label: str = "") -> list[dict[str, object]]:
    """One dict per cycle of a run; forces are the simulator's truth, never the estimate."""
    rows: list[dict[str, object]] = []
    for result in run.results:
        size = np.linalg.norm(result.internal[:, :3], axis=1)
        worst = int(np.argmax(size))
        at_knots = path.nearest(run.knots_m)
        rows.append(
            {
                "tier": "numpy",
                "row": label or run.name,
                "seed": run.errors.seed,
                "speed": path.speed,
                "cycle": result.summary.cycle,
                "force_n": float(size[worst]),
                "moment_nm": float(np.linalg.norm(result.internal[:, 3:], axis=1).max()),
                "rms_n": float(np.sqrt(np.mean(size**2))),
                "p99_n": float(np.percentile(size, 99.0)),
                "share_above": float(np.mean(size > LIMIT_N)),
                "at_first_knots_n": float(size[at_knots].max()),
                "worst_at_m": float(path.s_m[worst]),
                "oscillation": oscillation(result.internal, path.dt_s),
                "knots": result.summary.knots,
                "frozen": float(result.summary.cycle > run.freeze_after),
                "function": result.summary.function,
                "estimated_n": result.summary.force_n,
                "part_off_m": result.part_off_m,
            }
        )
    return rows
