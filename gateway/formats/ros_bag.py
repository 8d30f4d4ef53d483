"""Joint states of ROS 2, from MCAP files and from bags in SQLite (`.db3`)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import IO, Any, Final

import numpy as np

from gateway.data.extras import needed
from gateway.data.regular_file import regular_size
from gateway.errors import GatewayError, InputError
from gateway.formats.bag_database import BagDatabase, open_bag
from gateway.formats.log import Log
from gateway.formats.mcap_file import JOINT_STATE, JOINT_STATE_TEXT

#: Suffixes of what is read here.
SUFFIXES: Final = (".mcap", ".db3")
#: Arrays of a message with one value per joint.
_PARTS: Final = ("position", "velocity", "effort")
_NS: Final = 1_000_000_000
#: Unpacked size that a chunk may have [bytes], and all chunks together as a multiple of the file.
CHUNK_BYTES: Final = 32_000_000
UNPACKED_RATIO: Final = 200

#: Time of logging [ns], content.
_Raw = tuple[int, bytes]


def read_bag(path: Path, topic: str, joints: Sequence[str]) -> Log:
    """Read the messages of one topic that contain the joints of an arm.

    Columns are `stamp` and `log_time` [s] from the first message, and `position/NAME`, `velocity/NAME`, `effort/NAME`
    where the messages contain them. A message without any of the joints is ignored, as it is of another device.

    Parameters
    ----------
    path : Path
    topic : str
    joints : sequence of str
        Names; every message names all of them or none.

    Raises
    ------
    InputError
        It cannot be read, holds no such topic, is of another type, or a message lacks a joint.
    ConfigError
        mcap-ros2-support is not installed.
    """
    found = [
        (number, log_ns, message)
        for number, (log_ns, message) in enumerate(_messages(path, topic), start=1)
        if not set(joints).isdisjoint(message.name)
    ]
    if not found:
        raise InputError(f"{path}: no message on '{topic}' names the joints {', '.join(joints)}; see joints of the map")
    begun_ns, stamped_ns = found[0][1], _stamp_ns(found[0][2])
    lines = np.array([number for number, _, _ in found])
    columns = {
        "log_time": np.array([(log_ns - begun_ns) / _NS for _, log_ns, _ in found]),
        "stamp": np.array([(_stamp_ns(message) - stamped_ns) / _NS for _, _, message in found]),
    }
    for joint in joints:
        where = [_place(path, number, message, joint) for number, _, message in found]
        for part in _PARTS:
            reported = [
                _reported(path, found[row][0], getattr(found[row][2], part), at, f"{part}/{joint}")
                for row, at in enumerate(where)
            ]
            if not all(value is None for value in reported):
                columns[f"{part}/{joint}"] = np.array([np.nan if value is None else value for value in reported])
    return Log(str(path), columns, lines, "message ")


def _stamp_ns(message: Any) -> int:
    return int(message.header.stamp.sec) * _NS + int(message.header.stamp.nanosec)


def _place(path: Path, number: int, message: Any, joint: str) -> int:
    if joint not in message.name:
        raise InputError(f"{path}:message {number}: names {', '.join(message.name)}, and not joint '{joint}'")
    return list(message.name).index(joint)


def _reported(path: Path, number: int, values: Sequence[float], at: int, what: str) -> float | None:
    if len(values) == 0:
        return None
    if at >= len(values):
        raise InputError(f"{path}:message {number}: {what}: fewer values than names")
    return float(values[at])


def _messages(path: Path, topic: str) -> Iterator[tuple[int, Any]]:
    """Yield log time [ns] and decoded message, in file order."""
    decoder: Any = needed("mcap_ros2.decoder", "a ROS 2 bag", "formats").DecoderFactory()
    records: Any = needed("mcap.records", "a ROS 2 bag", "formats")
    try:
        raw = _of_mcap(path, topic) if path.suffix.lower() == ".mcap" else _of_sqlite(path, topic)
        schema = records.Schema(id=1, name=JOINT_STATE, encoding="ros2msg", data=JOINT_STATE_TEXT.encode())
        decode = decoder.decoder_for("cdr", schema)
        for log_ns, content in raw:
            message = decode(content)
            yield (
                log_ns,
                SimpleNamespace(
                    header=message.header,
                    name=list(message.name),
                    **{part: list(getattr(message, part)) for part in _PARTS},
                ),
            )
    except GatewayError:
        raise
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    except Exception as error:  # the libraries report damage by many kinds of exception
        words = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(f"{path}: is damaged, or not a bag ({words})") from error


def _of_mcap(path: Path, topic: str) -> Iterator[_Raw]:
    records: Any = needed("mcap.records", "MCAP", "formats")
    schemas: dict[int, str] = {}
    channels: dict[int, tuple[str, str]] = {}
    topics: dict[str, str] = {}
    with path.open("rb") as stream:
        for record in _records(path, stream):
            if isinstance(record, records.Schema):
                schemas[record.id] = record.name
            elif isinstance(record, records.Channel):
                channels[record.id] = record.topic, record.message_encoding
                topics[record.topic] = schemas.get(record.schema_id, "")
            elif isinstance(record, records.Message):
                name, form = channels[record.channel_id]
                if name == topic:
                    _refuse_type(path, topic, topics[topic], form)
                    yield record.log_time, record.data
    _refuse_without(path, topic, topics)


def _records(path: Path, stream: IO[bytes]) -> Iterator[Any]:
    """Yield the records of an MCAP file in order; the decompressed size of a chunk is limited."""
    library: Any = needed("mcap.stream_reader", "MCAP", "formats")
    records: Any = needed("mcap.records", "MCAP", "formats")
    size_bytes = regular_size(path)
    left_bytes = CHUNK_BYTES + UNPACKED_RATIO * size_bytes
    for record in library.StreamReader(stream, emit_chunks=True, record_size_limit=size_bytes).records:
        if isinstance(record, records.Chunk):
            data = _unpacked(path, record, min(CHUNK_BYTES, left_bytes))
            left_bytes -= len(data)
            yield from library.breakup_chunk(replace(record, compression="", data=data))
        else:
            yield record


def _unpacked(path: Path, chunk: Any, most_bytes: int) -> bytes:
    if chunk.compression == "zstd":
        zstandard: Any = needed("zstandard", "MCAP", "formats")
        data = zstandard.ZstdDecompressor().stream_reader(chunk.data).read(most_bytes + 1)
    elif chunk.compression == "lz4":
        lz4: Any = needed("lz4.frame", "MCAP", "formats")
        data = lz4.LZ4FrameDecompressor().decompress(chunk.data, most_bytes + 1)
    else:
        data = chunk.data
    if len(data) > most_bytes:
        raise InputError(f"{path}: a chunk unpacks to more than {most_bytes / 1e6:.0f} MB: record with smaller chunks")
    return data


def _of_sqlite(path: Path, topic: str) -> Iterator[_Raw]:
    with open_bag(path) as file:
        bag = BagDatabase(path, file)
        known = bag.topics()
        _refuse_without(path, topic, {name: kind for name, (_, kind, _) in known.items()})
        key, kind, form = known[topic]
        _refuse_type(path, topic, kind, form)
        yield from bag.messages(key)


def _refuse_type(path: Path, topic: str, kind: str, form: str) -> None:
    if kind not in (JOINT_STATE, JOINT_STATE.replace("/msg/", "/")) or form != "cdr":
        raise InputError(f"{path}: topic '{topic}' is {kind or 'of no type'} as {form}; {JOINT_STATE} as cdr is read")


def _refuse_without(path: Path, topic: str, topics: dict[str, str]) -> None:
    if topic not in topics:
        held = ", ".join(f"{name} ({kind})" for name, kind in topics.items()) or "no message"
        raise InputError(f"{path}: contains no topic '{topic}' but {held}; see topic under [log] of the map")
