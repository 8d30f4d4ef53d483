"""MCAP for PlotJuggler and Foxglove: two channels per arm.

`/NAME/joint_states` is displayed by every ROS 2 tool without configuration (`sensor_msgs/msg/JointState`).
`/NAME/samples` is JSON with all quantities, including raw words and labels, which that message cannot contain.
"""

from __future__ import annotations

import io
import json
import struct
from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np

from gateway.data.extras import needed
from gateway.formats.samples import ArmSamples, Measurand, Samples
from gateway.result.origin import software

JOINT_STATE: Final = "sensor_msgs/msg/JointState"
#: Definition of the message and of those it is made of (ROS 2 common_interfaces, Apache-2.0).
JOINT_STATE_TEXT: Final = "\n".join(
    [
        "std_msgs/Header header",
        "string[] name",
        "float64[] position",
        "float64[] velocity",
        "float64[] effort",
        "=" * 80,
        "MSG: std_msgs/Header",
        "builtin_interfaces/Time stamp",
        "string frame_id",
        "=" * 80,
        "MSG: builtin_interfaces/Time",
        "int32 sec",
        "uint32 nanosec",
        "",
    ]
)
_KINDS: Final = {"f": "number", "i": "integer", "u": "integer", "b": "boolean", "O": "string"}
_NS: Final = 1_000_000_000


def to_mcap(samples: Samples) -> bytes:
    """Return the content of an MCAP file.

    Messages have the time of the recording, which starts at zero when the bus is opened. Floats in the JSON read back
    exactly; NaN is null.

    Raises
    ------
    ConfigError
        mcap is not installed.
    """
    writer_module: Any = needed("mcap.writer", "MCAP", "formats")
    sink = io.BytesIO()
    writer = writer_module.Writer(sink)
    writer.start(profile="ros2", library=software())
    writer.add_metadata("recording", samples.about)
    for arm in samples.arms:
        writer.add_metadata(f"arms/{arm.name}", arm.about)
    joint_state = writer.register_schema(JOINT_STATE, "ros2msg", JOINT_STATE_TEXT.encode())
    for arm in samples.arms:
        text = json.dumps(
            {
                "title": f"samples of arm {arm.name}",
                "type": "object",
                "properties": {name: _property(measurand, arm.axes) for name, measurand in arm.measurands.items()},
            }
        )
        schema = writer.register_schema(f"servo_gateway/{arm.name}", "jsonschema", text.encode())
        complete = writer.register_channel(f"/{arm.name}/samples", "json", schema)
        units = {"position": "rad", "effort": "Nm"}
        states = writer.register_channel(f"/{arm.name}/joint_states", "cdr", joint_state, units)
        stamps = [round(time_s * _NS) for time_s in arm.measurands["time_s"].values.tolist()]
        for row, (stamp_ns, message) in enumerate(zip(stamps, _messages(arm), strict=True)):
            writer.add_message(complete, stamp_ns, json.dumps(message).encode(), stamp_ns, row)
            if "q_rad" in message:
                torque = arm.measurands.get("joint_torque_nm")
                state = joint_state_cdr(
                    stamp_ns,
                    arm.name,
                    arm.measurands["q_rad"].values[row],
                    (np.zeros(0) if torque is None or not torque.present[row].any() else torque.values[row]),
                )
                writer.add_message(states, stamp_ns, state, stamp_ns, row)
    writer.finish()
    return sink.getvalue()


def _messages(arm: ArmSamples) -> Iterator[dict[str, Any]]:
    """Yield one object per sample: absent quantities are omitted; null is NaN or a missing word."""
    columns = {name: _cells(measurand) for name, measurand in arm.measurands.items()}
    there = {name: measurand.there for name, measurand in arm.measurands.items()}
    for row in range(len(arm)):
        yield {name: cells[row] for name, cells in columns.items() if there[name][row]}


def _cells(measurand: Measurand) -> list[Any]:
    values = measurand.values.astype(object)
    values[~measurand.present] = None
    if measurand.values.dtype.kind == "f":
        values[~np.isfinite(measurand.values)] = None
    return values.tolist()


def _property(measurand: Measurand, axes: int) -> dict[str, Any]:
    kind: dict[str, Any] = {"type": [_KINDS[measurand.values.dtype.kind], "null"]}
    if measurand.values.ndim == 2:
        kind = {"type": "array", "items": kind, "minItems": axes, "maxItems": axes}
    else:
        kind = {"type": _KINDS[measurand.values.dtype.kind]}
    reported = ", ".join(filter(None, (measurand.unit, measurand.remark)))
    return kind | ({"unit": measurand.unit, "description": reported} if reported else {})


def joint_state_cdr(
    stamp_ns: int, frame: str, position_rad: np.ndarray, effort_nm: Sequence[float] | np.ndarray
) -> bytes:
    """Return a `JointState` in CDR, little endian (OMG DDSI-RTPS 2.3, 10.2); speeds are omitted, as they are not
    measured.

    Parameters
    ----------
    stamp_ns : int
    frame : str
        Name of the arm.
    position_rad : array of shape (N,)
    effort_nm : array of shape (N,) or (0,)
    """
    seconds, nanoseconds = divmod(stamp_ns, _NS)
    out = bytearray(struct.pack("<iI", seconds, nanoseconds))
    _put_text(out, frame)
    _put_count(out, len(position_rad))
    for axis in range(1, len(position_rad) + 1):
        _put_text(out, f"J{axis}")
    for values in (position_rad, (), effort_nm):
        _put_count(out, len(values))
        if len(values):
            out.extend(b"\0" * (-len(out) % 8))
            out.extend(struct.pack(f"<{len(values)}d", *values))
    return b"\x00\x01\x00\x00" + bytes(out)


def _put_count(out: bytearray, count: int) -> None:
    """Append a length, aligned to its size."""
    out.extend(b"\0" * (-len(out) % 4))
    out.extend(struct.pack("<I", count))


def _put_text(out: bytearray, text: str) -> None:
    content = text.encode() + b"\0"
    _put_count(out, len(content))
    out.extend(content)
