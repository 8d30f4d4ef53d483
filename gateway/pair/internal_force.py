"""Internal force of the part along a completed trajectory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gateway.pair.transform import Floats

#: Averaging time of torques of a completed trajectory: one vibration of a gear [s].
AVERAGED_S = 0.06


@dataclass(frozen=True, slots=True, eq=False)
class InternalForce:
    """Internal wrench of the part along a completed trajectory.

    Attributes
    ----------
    wrench : array of shape (M, 6)
        About the part's centre, world axes [N, Nm], at the time when the arms followed command m.
    covariance : array of shape (M, 6, 6)
    pulled : bool
        An external force acted on the arms, on this trajectory and not on the one before.
    """

    wrench: Floats
    covariance: Floats
    pulled: bool = False

    @property
    def size_std_n(self) -> Floats:
        """Return the standard deviation (M,) of the force's magnitude, along its own direction [N]."""
        force = self.wrench[:, :3]
        along = force / np.maximum(np.linalg.norm(force, axis=1, keepdims=True), 1e-9)
        return np.sqrt(np.einsum("ni,nij,nj->n", along, self.covariance[:, :3, :3], along))

    @property
    def std(self) -> Floats:
        """Return the standard deviation (M, 6) of each component."""
        return np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))
