"""One axis of a cell file with round numbers, for tests that compute by hand."""


def axis_table(node_id=1, ratio=100, **changes):
    """The table of an axis: gear ratio 100, 0.31 Nm/A, 2 rad to both sides, 0.5 rad/s, 200 Nm."""
    return {
        "node_id": node_id,
        "profile": "generic-cia402",
        "torque_constant_nm_per_a": {"value": 0.31, "source": "datasheet p. 2"},
        "gear_ratio": {"value": ratio, "source": "datasheet p. 7"},
        "gear_efficiency": {"value": 0.8, "source": "assumed"},
        "position_limit_rad": [-2.0, 2.0],
        "speed_limit_rad_s": 0.5,
        "torque_limit_nm": 200.0,
    } | changes
