"""Every decoder and reader that takes bytes from strangers, with what it must do for any of them.

A target is a strategy of inputs and a check of the result: a typed error or a correct value, never another exception.
The reader must end in time and use no memory beyond ten times the input.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

from hypothesis import strategies as st

from benchmarks.fuzz import check_files, check_follow, check_frames, check_pair, check_recordings


@dataclass(frozen=True, slots=True)
class Target:
    """One decoder (frames) or reader (files); `share` of the full number of inputs."""

    name: str
    kind: Literal["decoder", "reader"]
    strategy: Callable[[], st.SearchStrategy[Any]]
    check: Callable[[Any], None]
    share: float = 1.0


TARGETS: tuple[Target, ...] = (
    Target("emcy", "decoder", check_frames.emergencies, check_frames.check_emergency),
    Target("pdo", "decoder", check_frames.answers, check_frames.check_answers),
    Target("odd frames", "decoder", check_frames.odd_frames, check_frames.check_odd_frames),
    Target("heartbeat", "decoder", check_frames.heartbeats, check_frames.check_heartbeat),
    Target("sdo upload", "decoder", check_frames.sdo_answers, check_frames.check_upload),
    Target("sdo download", "decoder", check_frames.sdo_answers, check_frames.check_download),
    Target("cell toml", "reader", check_files.cells, check_files.check_cell),
    Target("profile toml", "reader", check_files.profiles, check_files.check_profile),
    Target("urdf", "reader", check_files.robots, check_files.check_urdf),
    Target("csv", "reader", check_files.tables, check_files.check_csv),
    Target("scenario toml", "reader", check_files.scenarios, check_files.check_scenario),
    Target("ledger json", "reader", check_files.ledgers, check_files.check_ledger, 0.2),
    Target("eds", "reader", check_files.sheets, check_files.check_sheet, 0.1),
    Target("recording bytes", "reader", check_recordings.recordings, check_recordings.check_recording, 0.8),
    Target("recording content", "reader", check_recordings.changes, check_recordings.check_changes, 0.2),
    Target("result json", "reader", check_files.results, check_files.check_result),
    Target("follow path toml", "reader", check_follow.toml_paths, check_follow.check_toml_path),
    Target("follow path csv", "reader", check_follow.csv_paths, check_follow.check_csv_path),
    Target("load json", "reader", check_follow.loads, check_follow.check_load),
    Target("pair cell toml", "reader", check_pair.cells, check_pair.check_cell),
    Target("pair path csv", "reader", check_pair.paths, check_pair.check_path),
    Target("pair function json", "reader", check_pair.functions, check_pair.check_function),
    Target("taught points json", "reader", check_pair.taught_paths, check_pair.check_taught_path),
    Target("pair state json", "reader", check_pair.states, check_pair.check_state),
    Target("pair run json", "reader", check_pair.runs, check_pair.check_run),
)
