"""Joint states of ROS 2, from MCAP files and from bags in SQLite (`.db3`).

A database of unknown origin can compute instead of store: a view or virtual table named `messages` may yield rows
without end. Therefore only real tables are read, in storage order (no temporary sorting). At most as many bytes as the
file contains are accepted. The time limit depends on the size of the file.
"""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import IO, Any, Final

import numpy as np

from gateway.data.extras import needed
from gateway.data.regular_file import regular_size
from gateway.errors import GatewayError, InputError
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
            most_bytes = min(CHUNK_BYTES, left_bytes)
            if record.compression == "zstd":
                zstandard: Any = needed("zstandard", "MCAP", "formats")
                data = zstandard.ZstdDecompressor().stream_reader(record.data).read(most_bytes + 1)
            elif record.compression == "lz4":
                lz4: Any = needed("lz4.frame", "MCAP", "formats")
                data = lz4.LZ4FrameDecompressor().decompress(record.data, most_bytes + 1)
            else:
                data = record.data
            if len(data) > most_bytes:
                raise InputError(
                    f"{path}: a chunk unpacks to more than {most_bytes / 1e6:.0f} MB: record with smaller chunks"
                )
            left_bytes -= len(data)
            yield from library.breakup_chunk(replace(record, compression="", data=data))
        else:
            yield record


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


#: Steps of SQLite's engine between two looks at the clock and at signals.
STEPS: Final = 50_000
#: Time that any bag may take [s], and what a second more is granted for [bytes].
LEAST_S: Final = 20.0
SLOWEST_BYTES_S: Final = 2_000_000.0


class BagDatabase:
    """Open bag database.

    Parameters
    ----------
    path : Path
    file : sqlite3.Connection

    Raises
    ------
    InputError
        `topics` or `messages` is not a real table.
    """

    def __init__(self, path: Path, file: sqlite3.Connection) -> None:
        self._path, self._file = path, file
        self._size_bytes = regular_size(path)
        self._until_s = time.monotonic() + LEAST_S + self._size_bytes / SLOWEST_BYTES_S
        self._raised: BaseException | None = None
        file.execute("PRAGMA trusted_schema = OFF")
        file.execute("PRAGMA temp_store = MEMORY")
        file.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, max(self._size_bytes, 1 << 20))
        file.set_progress_handler(self._look, STEPS)
        for name in ("topics", "messages"):
            query = "SELECT rootpage FROM sqlite_master WHERE type = 'table' AND name = ?"
            # a view or a virtual table has no page of its own
            if not any(page for (page,) in file.execute(query, (name,))):
                raise InputError(f"{path}: is not a bag: '{name}' is not a table of the file; record the bag again")

    def topics(self) -> dict[str, tuple[int, str, str]]:
        """Return key, type and serialization by topic name."""
        found = self._rows("SELECT id, name, type, serialization_format FROM topics", ())
        return {name: (key, kind, form) for key, name, kind, form in found}

    def messages(self, key: int) -> Iterator[tuple[int, bytes]]:
        """Yield the log time [ns] and content of each message of a topic."""
        for log_ns, content in self._rows(
            "SELECT timestamp, data FROM messages WHERE topic_id = ? ORDER BY rowid", (key,)
        ):
            yield int(log_ns), bytes(content)

    def _rows(self, query: str, values: tuple[int, ...]) -> Iterator[tuple[Any, ...]]:
        read_bytes = 0
        try:
            for row in self._file.execute(query, values):
                read_bytes += sum(len(cell) for cell in row if isinstance(cell, str | bytes)) + len(row)
                if read_bytes > self._size_bytes:
                    raise InputError(
                        f"{self._path}: yields more bytes than the file contains: damaged or not a bag; record again"
                    )
                yield row
        except sqlite3.OperationalError:
            if self._raised is not None:
                raise self._raised from None
            raise

    def _look(self) -> int:
        """Check the time limit; called by SQLite also during queries without rows, so that signals are handled."""
        try:
            if time.monotonic() > self._until_s:
                raise InputError(
                    f"{self._path}: takes too long for a bag of its size: it is damaged, or not a bag; record it again"
                )
        except BaseException as error:
            self._raised = error
            return 1
        return 0


def open_bag(path: Path) -> closing[sqlite3.Connection]:
    """Open a bag read-only, as a context manager."""
    return closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True))
