"""Messages of a ROS 2 bag in SQLite, read from the tables alone and within the size of the file.

A database of unknown origin can compute instead of store: a view or virtual table named `messages` may yield rows
without end. Therefore only real tables are read, in storage order (no temporary sorting). At most as many bytes as
the file contains are accepted. The time limit depends on the size of the file.
"""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any, Final

from gateway.data.regular_file import regular_size
from gateway.errors import InputError

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
