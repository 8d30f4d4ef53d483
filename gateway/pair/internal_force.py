"""Force inside the part along a way that is over."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gateway.pair.transform import Floats

#: Time over which torques are averaged for a way that is over: one vibration of a gear [s].
AVERAGED_S = 0.06


@dataclass(frozen=True, slots=True, eq=False)
class InternalForce:
    """Wrench inside the part along a way that is over.

    Attributes
    ----------
    wrench : array of shape (M, 6)
        About the part's centre, world axes [N, Nm], where the arms did what command m says.
    covariance : array of shape (M, 6, 6)
    pulled : bool
        Something beside the part has pulled at the arms, on this way and not on the one before.
    """

    wrench: Floats
    covariance: Floats
    pulled: bool = False

    @property
    def size_std_n(self) -> Floats:
        """Standard deviation (M,) of the force's size, along its own direction [N]."""
        force = self.wrench[:, :3]
        along = force / np.maximum(np.linalg.norm(force, axis=1, keepdims=True), 1e-9)
        return np.sqrt(np.einsum("ni,nij,nj->n", along, self.covariance[:, :3, :3], along))

    @property
    def std(self) -> Floats:
        """Standard deviation (M, 6) of each component."""
        return np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))
