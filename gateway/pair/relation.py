"""The relation between two grippers and the slave's command that follows from it (CN104379308 eqs. (3), (4))."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from gateway.pair.transform import Floats, inverse


def relation(w_t_b1: ArrayLike, b1_t_e1: ArrayLike, w_t_b2: ArrayLike, b2_t_e2: ArrayLike) -> Floats:
    """Pose of gripper 2 in gripper 1, eq. (3).

    Parameters
    ----------
    w_t_b1, w_t_b2 : arrays of shape (4, 4)
        Bases of master and slave in the world [m].
    b1_t_e1, b2_t_e2 : arrays of shape (..., 4, 4)
        Gripper poses in their own bases [m].

    Returns
    -------
    array of shape (..., 4, 4)
        `E1_T_E2 = inv(W_T_B1 B1_T_E1) W_T_B2 B2_T_E2`.
    """
    return inverse(np.asarray(w_t_b1) @ np.asarray(b1_t_e1)) @ (np.asarray(w_t_b2) @ np.asarray(b2_t_e2))


def slave_command(w_t_b1: ArrayLike, b1_t_e1: ArrayLike, w_t_b2: ArrayLike, e1_t_e2: ArrayLike) -> Floats:
    """Command of gripper 2 in its base, eq. (4): `B2_T_E2 = inv(W_T_B2) W_T_B1 B1_T_E1 E1_T_E2`; shapes (..., 4, 4)."""
    return (inverse(w_t_b2) @ np.asarray(w_t_b1)) @ np.asarray(b1_t_e1) @ np.asarray(e1_t_e2)
