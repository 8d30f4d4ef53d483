"""What is drawn of a long pass holds the peak of every axis, which the table names."""

from types import SimpleNamespace

import numpy as np

from gateway.follow.comparison import CURVE_POINTS, _chosen


def test_a_thinned_curve_holds_the_peak_of_every_axis():
    """Each axis has its peak in the one stretch in which another axis is just as far off."""
    error = 1e-3 * np.random.default_rng(3).normal(size=(20 * CURVE_POINTS, 6))
    for axis in range(6):
        error[101 + axis, axis] = 0.1 * (axis + 1)
    chosen = _chosen(SimpleNamespace(error_rad=error))
    assert np.abs(error[chosen]).max(axis=0).tolist() == np.abs(error).max(axis=0).tolist()
    assert len(chosen) <= CURVE_POINTS + 6
    assert (np.diff(chosen) > 0).all()
