"""Read the samples of a visit or a period: raw drive words, and the values computed from them."""

from __future__ import annotations

import numpy as np

from gateway.data.recording.hdf5_text import Hdf5Group
from gateway.data.visit import NO_WORD

#: Relative difference between a stored torque and the one that follows from its raw word.
SAME_TORQUE = 1e-6


def read_samples(place: Hdf5Group, axes: int, torque_unit_nm: np.ndarray | None) -> dict[str, np.ndarray]:
    """Return the sample arrays by the field names of `Visit` and `Period`.

    Parameters
    ----------
    place : Hdf5Group
        Group of the visit or period.
    axes : int
    torque_unit_nm : array of shape (N,) or None
        Motor torque per bit of the torque word; None = not in the file.

    Raises
    ------
    InputError
        Missing, of another shape, not finite, not one row per sample, no sample, or a torque that disagrees with
        its raw words.
    """

    def words(name: str) -> np.ndarray:
        return place.array(name, axes, "iu").astype(np.int64)

    torque_word, stored_nm = words("torque_permille"), finite(place, "motor_torque_nm", axes)
    motor_nm = stored_nm if torque_unit_nm is None else torque_word * torque_unit_nm
    if motor_nm.shape != stored_nm.shape or not np.allclose(motor_nm, stored_nm, rtol=SAME_TORQUE, atol=1e-12):
        raise place.refuse("motor_torque_nm", "disagrees with torque_permille and the constants of the file")
    absent = np.full(torque_word.shape, NO_WORD, dtype=np.int64)
    arrays = {
        "statusword": words("statusword"),
        "position_count": words("position_count"),
        "torque_word": torque_word,
        "current_word": words("current_permille") if place.has("current_permille") else absent,
        "velocity_word": words("velocity_word") if place.has("velocity_word") else absent,
        "q_rad": finite(place, "q_rad", axes),
        "motor_torque_nm": motor_nm,
        "joint_torque_nm": finite(place, "joint_torque_nm", axes),
        "motor_current_a": place.array("motor_current_a", axes, "f")
        if place.has("motor_current_a")
        else absent * np.nan,
        "sync_index": place.array("sync_index", None, "iu").astype(np.int64),
        "time_s": finite(place, "time_s", None),
    }
    require_length(place, arrays, len(torque_word))
    if not len(torque_word):
        raise place.refuse("", "contains no sample")
    if (np.diff(arrays["sync_index"]) <= 0).any():
        raise place.refuse("sync_index", "does not increase")
    return arrays


def finite(place: Hdf5Group, name: str, columns: int | None) -> np.ndarray:
    """Return a dataset of finite floats; raise `InputError` if a value is not finite."""
    values = place.array(name, columns, "f").astype(float)
    if not np.isfinite(values).all():
        raise place.refuse(name, "contains a value that is not finite")
    return values


def require_length(place: Hdf5Group, arrays: dict[str, np.ndarray], n_samples: int) -> None:
    """Check that arrays have one row per sample."""
    for name, values in arrays.items():
        if len(values) != n_samples:
            raise place.refuse(name, f"has {len(values)} samples, torque_permille has {n_samples}")
