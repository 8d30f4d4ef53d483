"""References by which a cyclic master would move a simulated arm."""

import numpy as np

from sim.physics import ArmWorld


def moved(world: ArmWorld, q: np.ndarray, seconds: float) -> np.ndarray:
    """Stream a smooth reference (quintic) to a posture; return the largest following error of each axis (N,)."""
    start = np.array([axis.servo.reference_rad for axis in world.axes])
    lag = np.zeros(len(start))
    for share in np.linspace(0.0, 1.0, int(seconds / 0.01) + 1)[1:]:
        goal = start + (q - start) * share**3 * (10 - 15 * share + 6 * share**2)
        for axis, target in zip(world.axes, goal.tolist(), strict=True):
            axis.servo.reference_step_rad = (target - axis.servo.reference_rad) / 10
        world.advance(10)
        lag = np.maximum(lag, [abs(axis.servo.error_rad) for axis in world.axes])
    for axis in world.axes:
        axis.servo.reference_step_rad = 0.0
    return lag
