"""Files that were valid once, after a few edits: every reader answers them with a result or a typed error.

Each reader runs in a process of its own, so that a library that ends it is counted and not suffered. Counted are: a
crash or an untyped error, more than 2 s of processor time, more than 500 MB of memory, a file outside the input's
folder. STRANGERS_INPUTS sets how many inputs a reader gets.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.figure import figure
from benchmarks.fuzz.mutate import TOKENS, apply_edits

INPUTS = int(os.environ.get("STRANGERS_INPUTS", "10000"))
MOST_S, MOST_BYTES = 2.0, 500e6
#: Without a sign of life for so long, a process is ended and counted as a crash [s].
NO_OUTPUT_S = 120.0
ROOT = Path(__file__).resolve().parents[2]
KINDS = ("delete", "repeat", "insert", "replace", "cut", "swap")
FAULTS = ("crash", "time", "memory", "outside")


def mutated(seeds: list[bytes], number: int) -> bytes:
    """One of the seeds after one to five edits, the same one for the same number."""
    rng = np.random.default_rng([number, 3])
    edits = [
        (
            str(rng.choice(KINDS)),
            int(rng.integers(0, 2**20)),
            int(rng.integers(0, rng.choice([8, 4000]))),
            TOKENS[rng.integers(len(TOKENS))] if rng.random() < 0.5 else rng.bytes(int(rng.integers(1, 7))),
        )
        for _ in range(rng.integers(1, 6))
    ]
    return apply_edits(seeds[number % len(seeds)], edits)


# -- readers: name of the file, seeds, and what reads it ---------------------------------------------------------------


def _example(name: str) -> bytes:
    return (ROOT / "examples" / name).read_bytes()


def table_csv() -> tuple[str, list[bytes], Callable[[Path], Any]]:
    from benchmarks.fuzz.check_files import CSV_SEEDS
    from gateway.data.table import read_csv

    return "table.csv", CSV_SEEDS, lambda path: read_csv(path, None)


def text_log() -> tuple[str, list[bytes], Callable[[Path], Any]]:
    from gateway.formats.log_map import read_map
    from gateway.formats.measured import table_from_log

    column_map = read_map(Path("ur-rtde"))
    names = ["timestamp", *(f"actual_{what}_{axis}" for what in ("q", "qd", "current") for axis in range(6))]
    rows = [[f"{0.008 * row:.3f}", *(f"{np.sin(0.1 * row + i):.6f}" for i in range(18))] for row in range(40)]
    plain = "\n".join(",".join(row) for row in [names, *rows])
    comma = "\n".join(";".join(cell.replace(".", ",") for cell in row) for row in [names, *rows])
    seeds = [plain.encode(), comma.encode(), plain.encode("utf-16")]
    return "log.csv", seeds, lambda path: table_from_log(path, column_map)


def cell_toml() -> tuple[str, list[bytes], Callable[[Path], Any]]:
    from gateway.cell.config import load_cell

    seeds = [_example(f"{name}/cell.toml") for name in ("small", "large", "pair")]
    return "cell.toml", seeds, load_cell


def urdf() -> tuple[str, list[bytes], Callable[[Path], Any]]:
    from gateway.model.robot import robot_from_urdf
    from gateway.model.urdf_text import read_urdf

    seeds = [_example(f"{name}/robot.urdf") for name in ("small", "large")]
    return "robot.urdf", seeds, lambda path: robot_from_urdf(read_urdf(path), path.name)


def data_sheet() -> tuple[str, list[bytes], Callable[[Path], Any]]:
    from drives.datasheet.building import read_sheet

    return "drive.eds", [_example("own/drive.eds")], read_sheet


def dcf() -> tuple[str, list[bytes], Callable[[Path], Any]]:
    from drives.configuration.dcf import read_dcf

    seed = _example("own/drive.eds").replace(b"AccessType=rw", b"AccessType=rw\nParameterValue=1")
    return "drive.dcf", [seed + b"\n[DeviceComissioning]\nNodeID=3\n"], lambda path: read_dcf(path, 3)


def recording(forged: bool = False) -> tuple[str, list[bytes], Callable[[Path], Any]]:
    from gateway.cell.config import load_cell
    from gateway.data.recording import seal
    from gateway.data.recording.reader import read
    from gateway.data.recording.writer import RecordingWriter
    from tests.data.visits import ARM_HEADER, header_of, visit

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.h5"
        writer = RecordingWriter(path, header_of(load_cell(ROOT / "examples" / "small" / "cell.toml")), None)
        writer.begin(ARM_HEADER)
        for pose in (1, 2):
            writer.add("main", visit(pose, 1, start_s=float(pose)))
        writer.finish("main", "success", "all poses measured", {"cycles": 7})
        writer.close()
        seed = path.read_bytes()
    if not forged:
        return "run.h5", [seed], read

    seal.PROBE_TIMEOUT_S = 5.0  # a blocked reader is waited for; a minute each would take hours

    def sealed_and_read(path: Path) -> Any:
        """The checksum is made to fit the edits, so that libhdf5 gets to see them."""
        path.write_bytes(seal.sealed(path.read_bytes()))
        return read(path)

    return "run.h5", [seed[: -seal.SEAL_BYTES]], sealed_and_read


def parquet() -> tuple[str, list[bytes], Callable[[Path], Any]]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    from gateway.fleet.summaries import summary_blocks
    from tests.data.fleets import checks

    seeds = []
    for compression in ("none", "snappy", "zstd"):
        sink = pa.BufferOutputStream()
        pq.write_table(pa.Table.from_pylist(checks("one", days=range(20))), sink, compression=compression)
        seeds.append(sink.getvalue().to_pybytes())
    now = datetime(2026, 6, 1, tzinfo=UTC)
    return "checks.parquet", seeds, lambda path: list(summary_blocks(path, now))


def _bags(folder: Path) -> tuple[bytes, bytes]:
    """The same messages as MCAP and in SQLite."""
    from mcap.reader import make_reader
    from mcap_ros2.writer import Writer

    from gateway.formats.mcap_file import JOINT_STATE, JOINT_STATE_TEXT

    path = folder / "bag.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        schema = writer.register_msgdef(JOINT_STATE, JOINT_STATE_TEXT)
        for number in range(20):
            stamp = {"stamp": {"sec": 1, "nanosec": number * 4_000_000}, "frame_id": ""}
            values = {part: [0.1 * number, 0.2] for part in ("position", "velocity", "effort")}
            message = {"header": stamp, "name": ["base", "arm"], **values}
            writer.write_message("/joint_states", schema, message, log_time=number)
        writer.finish()
    with path.open("rb") as stream:
        raw = [(message.log_time, message.data) for _, _, message in make_reader(stream).iter_messages()]
    with closing(sqlite3.connect(folder / "bag.db3")) as file:
        file.execute("CREATE TABLE topics (id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)")
        file.execute("CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)")
        file.execute("INSERT INTO topics VALUES (2, '/joint_states', ?, 'cdr')", (JOINT_STATE,))
        file.executemany("INSERT INTO messages (topic_id, timestamp, data) VALUES (2, ?, ?)", raw)
        file.commit()
    return path.read_bytes(), (folder / "bag.db3").read_bytes()


def _bag(which: int) -> tuple[str, list[bytes], Callable[[Path], Any]]:
    from gateway.formats.ros_bag import read_bag

    with tempfile.TemporaryDirectory() as folder:
        seed = _bags(Path(folder))[which]
    return ("bag.mcap", "bag.db3")[which], [seed], lambda path: read_bag(path, "/joint_states", ("base", "arm"))


#: Recordings whose checksum is made to fit the edits, so that libhdf5 reads them: counted on their own.
FORGED = "recording HDF5, sealed again"
READERS: dict[str, Callable[[], tuple[str, list[bytes], Callable[[Path], Any]]]] = {
    "table CSV": table_csv,
    "text log": text_log,
    "recording HDF5": recording,
    FORGED: lambda: recording(forged=True),
    "EDS": data_sheet,
    "DCF": dcf,
    "cell TOML": cell_toml,
    "URDF": urdf,
    "bag MCAP": lambda: _bag(0),
    "bag SQLite": lambda: _bag(1),
    "Parquet": parquet,
}


# -- one process -------------------------------------------------------------------------------------------------------


class Unfinished(BaseException):
    """One input took far longer than it may."""


def _expired(_signal: int, _frame: object) -> None:
    raise Unfinished


def work(reader: str, first: int, inputs: int, folder: Path) -> None:
    """Read inputs, a line of JSON for each fault and a line with the number of each input."""
    from drives.errors import DriveError
    from gateway.errors import GatewayError

    name, seeds, read = READERS[reader]()
    path = folder / "in" / name
    (folder / "in" / "robot.urdf").write_bytes(_example("small/robot.urdf"))
    path.write_bytes(seeds[0])
    read(path)  # loads what the reader needs
    signal.signal(signal.SIGVTALRM, _expired)
    os.chdir(folder / "cwd")
    for number in range(first, inputs):
        print(number, flush=True)
        path.write_bytes(mutated(seeds, number))
        before_s, before_kb = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        signal.setitimer(signal.ITIMER_VIRTUAL, 5 * MOST_S)
        try:
            read(path)
        except (GatewayError, DriveError):
            pass
        except (Exception, Unfinished) as error:
            print(json.dumps(["crash", number, f"{type(error).__name__}: {error}"[:300]]), flush=True)
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        took_s = time.process_time() - before_s
        grown = 1024.0 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb)
        if took_s > MOST_S:
            print(json.dumps(["time", number, f"{took_s:.1f} s"]), flush=True)
        if grown > MOST_BYTES:
            print(json.dumps(["memory", number, f"{grown / 1e6:.0f} MB"]), flush=True)


def tried(reader: str) -> list[tuple[str, int, str]]:
    """Faults of a reader: kind, number of the input, what was seen."""
    found: list[tuple[str, int, str]] = []
    first = 0
    while first < INPUTS:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            for part in ("in", "cwd", "tmp"):
                (folder / part).mkdir()
            words = [sys.executable, "-m", "benchmarks.strangers.hostile", reader, str(first), str(INPUTS), name]
            process = subprocess.Popen(
                words, cwd=ROOT, env=os.environ | {"TMPDIR": str(folder / "tmp")}, text=True,
                stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            )  # fmt: skip
            assert process.stdout is not None
            last = first - 1
            signal.signal(signal.SIGALRM, lambda *_, ended=process: ended.kill())
            for line in process.stdout:
                signal.alarm(int(NO_OUTPUT_S))
                if line[0] == "[":
                    kind, number, what = json.loads(line)
                    found.append((kind, number, what))
                else:
                    last = int(line)
            signal.alarm(0)
            code = process.wait()
            own = {folder / "in", folder / "cwd", folder / "tmp"}
            strange = [path for path in folder.rglob("*") if path not in own and path.parent != folder / "in"]
            found += [("outside", last, str(path)) for path in strange]
            if code == 0:
                break
            if last < first:
                raise SystemExit(f"{reader}: its process does not start (exit {code})")
            found.append(("crash", last, f"the process ended with {code}"))
            first = last + 1
    return found


def figures() -> dict[str, dict]:
    """Faults of every reader, by kind; each is said on stderr."""
    counts, forged = dict.fromkeys(FAULTS, 0), 0
    for reader in READERS:
        began_s = time.monotonic()
        for kind, number, what in tried(reader):
            if reader == FORGED:
                forged += 1
            else:
                counts[kind] += 1
            print(f"{reader}, input {number}: {kind}: {what}", file=sys.stderr, flush=True)
        print(f"{reader}: {INPUTS} inputs, {time.monotonic() - began_s:.0f} s", file=sys.stderr, flush=True)
    names = {
        "crash": "crashes and untyped errors", "time": "more than 2 s", "memory": "more than 500 MB",
        "outside": "files written outside the folder",
    }  # fmt: skip
    return {
        "hostile files: faults of recordings whose checksum was forged": figure(forged, "== 0"),
        "hostile files: inputs a reader": figure(INPUTS, ">= 10000"),
        "hostile files: readers": figure(len(READERS), ">= 7"),
        **{f"hostile files: {names[kind]}": figure(count, "== 0") for kind, count in counts.items()},
    }


if __name__ == "__main__":
    work(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), Path(sys.argv[4]))
