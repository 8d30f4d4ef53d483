"""The process that writes, and the header of a recording."""

from collections.abc import Iterator

import pytest

from gateway.cell.config import load_cell
from gateway.data.disk import Disk
from gateway.data.recording.writer import RecordingHeader
from tests.data.visits import CELL, header_of
from tests.support.processes import children


@pytest.fixture(scope="module")
def header() -> RecordingHeader:
    return header_of(load_cell(CELL))


@pytest.fixture
def disk() -> Iterator[Disk]:
    """Leaves no process behind."""
    before = set(children())
    with Disk() as disk:
        yield disk
    assert set(children()) <= before
