"""From a store to states and pages: who is named, and that nothing that is missing counts as healthy."""

from __future__ import annotations

import json
from datetime import UTC, timedelta
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from gateway.cell.config import load_cell
from gateway.errors import InputError
from gateway.fleet import workers as workers_module
from gateway.fleet.analysis import run_analysis
from gateway.fleet.columns import SCHEMA_KEY
from gateway.fleet.ingest import ingest
from gateway.fleet.store import Store, open_or_make
from gateway.report.fleet_page import headline, render_fleet, render_robot
from gateway.result.fleet import FleetHealth, RobotLine, read_fleet, read_robot
from gateway.result.origin import sealed
from tests.data.fleets import FIRST, checks, one_by_one, write_table
from tests.data.visits import CELL, both_sides, header_of, recording_of
from tests.support.rigs.command_line import run

DAYS = 200
NOW = FIRST.replace(tzinfo=UTC) + timedelta(days=DAYS)


def analysed(store: Store, tmp_path: Path, *robots: list[dict[str, object]]) -> FleetHealth:
    """An analysis of the robots of these rows, in this process."""
    for number, rows in enumerate(robots):
        ingest(store, [write_table(tmp_path / f"robot{number}.csv", rows)], NOW)
    return run_analysis(store, one_by_one, NOW)


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return open_or_make(tmp_path / "store")


def line(fleet: FleetHealth, cell: str) -> RobotLine:
    return next(each for each in fleet.robots if each.cell == cell)


def test_robots_are_ranked_and_what_is_missing_is_not_healthy(store: Store, tmp_path: Path) -> None:
    every = range(DAYS)
    half = [row | {"gain2": ""} for row in checks("half", days=every)]
    fleet = analysed(
        store,
        tmp_path,
        checks("calm", days=every),
        checks("worn", days=every, gain_per_year=0.05),
        checks("gone", days=range(120)),
        checks("young", days=range(DAYS - 10, DAYS)),
        half,
    )
    assert [(each.cell, each.state) for each in fleet.robots[:2]] == [("worn", "visit"), ("gone", "not seen")]
    assert [(each.cell, each.state) for each in fleet.robots[-1:]] == [("calm", "healthy")]
    assert line(fleet, "worn").why[0].startswith("J2: gain of the torque drifts by ")
    assert line(fleet, "gone").why[0] == "not seen since 2026-04-30, 81 days"
    assert line(fleet, "young").state == "cannot tell"
    assert "the gain of J2 was never measured" in line(fleet, "half").why
    assert headline(fleet) == "1 of 5 robots needs service, 3 cannot be assessed"
    again = read_fleet(store.analysis / "fleet.json")
    assert [each.robot for each in again.robots] == [each.robot for each in fleet.robots]


def test_a_change_of_load_is_reported(store: Store, tmp_path: Path) -> None:
    rows = checks("a", days=range(DAYS))
    changed = [row | {"mass_kg": float(str(row["mass_kg"])) + 1.0} for row in rows[150:]]
    fleet = analysed(store, tmp_path, [*rows[:150], *changed])
    assert fleet.robots[0].state == "visit"
    (load,) = read_robot(store.analysis / "robots" / f"{fleet.robots[0].robot}.json").loads
    assert (load.program, load.outcome, load.checks) == ("pick", "fail", DAYS)
    assert "another load" in load.why


def test_check_that_says_fail_asks_for_a_visit(store: Store, tmp_path: Path) -> None:
    fleet = analysed(store, tmp_path, [row | {"outcome": "fail"} for row in checks("a", days=range(DAYS))])
    assert fleet.robots[0].why[0] == "load 'pick': the last check did not accept it"


def test_checks_of_a_wrong_clock_alone_are_not_seen(store: Store, tmp_path: Path) -> None:
    rows = [row | {"time_utc": "1970-01-01T00:00:00"} for row in checks("a", days=range(3))]
    (only,) = analysed(store, tmp_path, rows).robots
    assert (only.state, only.why[0]) == ("not seen", "no check with a plausible time: set the clock of the robot")


def test_store_of_two_schemas_names_the_file_and_judges_the_others(store: Store, tmp_path: Path) -> None:
    ingest(store, [write_table(tmp_path / "a.csv", checks("a", days=range(DAYS)))], NOW)
    ingest(store, [write_table(tmp_path / "b.csv", checks("b", days=range(3)))], NOW)
    (file,) = store.files(store.robots()[1])
    other = pq.read_table(file, partitioning=None).replace_schema_metadata({SCHEMA_KEY: b"2"})
    pq.write_table(other, file)
    fleet = run_analysis(store, one_by_one, NOW)
    assert len(fleet.failed) == 1
    assert "is of schema 2" in fleet.failed[0]
    assert [each.state for each in fleet.robots] == ["cannot tell", "healthy"]


def test_recordings_are_estimated_once_by_a_version(store: Store, tmp_path: Path) -> None:
    run = recording_of(tmp_path / "run.h5", header_of(load_cell(CELL)), both_sides(1, 2))
    ingest(store, [run], NOW)
    assert run_analysis(store, one_by_one, NOW).estimated == 1
    assert run_analysis(store, one_by_one, NOW).estimated == 0
    (robot,) = store.robots()
    kinds = store.read(robot)["kind"].to_pylist()
    assert sorted(kinds) == ["estimate", "recording"]
    (only,) = read_fleet(store.analysis / "fleet.json").robots
    assert only.checks == 1
    assert only.state != "healthy"


def test_pages_name_every_axis_with_its_unit_and_fetch_nothing(store: Store, tmp_path: Path) -> None:
    fleet = analysed(
        store, tmp_path, checks("calm <b>", days=range(DAYS)), checks("worn", days=range(DAYS), gain_per_year=0.05)
    )
    page = render_fleet(read_fleet(store.analysis / "fleet.json"))
    assert "drift of the gain [% a year]" in page
    assert "1 of 2 robots needs service" in page
    robot = read_robot(store.analysis / "robots" / f"{line(fleet, 'calm <b>').robot}.json")
    own = render_robot(robot)
    for label in ("J1 gain [1]", "J2 friction [Nm]", "pick mass [kg]", "days since the first check [d]"):
        assert label in own
    assert "calm &lt;b&gt;" in own
    for text in (page, own):
        assert "<b>:" not in text
        assert "http" not in text
        assert "src=" not in text


def test_edited_analysis_is_refused(store: Store, tmp_path: Path) -> None:
    analysed(store, tmp_path, checks("a", days=range(40)))
    file = store.analysis / "fleet.json"
    file.write_text(file.read_text().replace('"checks": 40', '"checks": 41'))
    with pytest.raises(InputError, match="was edited"):
        read_fleet(file)


# -- the commands ------------------------------------------------------------------------------------------------------


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch):
    """Analyses run in this process."""
    from contextlib import contextmanager

    @contextmanager
    def alone(_scheduler):
        yield one_by_one

    monkeypatch.setattr(workers_module, "workers", alone)


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["--scheduler", "tcp://h:1"], 0, "unauthenticated, unencrypted pickles"),
        (["--scheduler", "tls://h:1"], 0, None),
        ([], 0, None),
    ],
)
def test_a_scheduler_without_certificates_is_named_as_such(tmp_path: Path, words, code, said) -> None:
    store = tmp_path / "store"
    run("fleet", "ingest", store, write_table(tmp_path / "a.csv", checks("one", days=range(3))))
    done = run("fleet", "analyse", store, "--as-of", "2026-02-11", *words)
    assert done.exit_code == code, done.output
    assert ("pickles" in done.output) == (code == 0 and said is not None)
    assert said is None or said in " ".join(done.output.split())


def test_a_robot_of_a_store_cannot_name_a_file_elsewhere(store: Store, tmp_path: Path) -> None:
    analysed(store, tmp_path, checks("a", days=range(40)))
    data = json.loads((store.analysis / "fleet.json").read_text())
    data["robots"][0]["robot"] = "../../outside"
    (store.analysis / "fleet.json").write_text(json.dumps(sealed(data)))
    with pytest.raises(InputError, match=r"'\.\./\.\./outside' is not a name of a robot"):
        read_fleet(store.analysis / "fleet.json")


@pytest.mark.usefixtures("here")
def test_commands_from_files_to_pages(tmp_path: Path) -> None:
    table = write_table(tmp_path / "a.csv", checks("one", days=range(40)))
    store = tmp_path / "store"
    done = run("fleet", "ingest", store, table)
    assert (done.exit_code, "40 checks added, 0 already stored, from 1 files" in done.output) == (0, True), done.output
    done = run("fleet", "analyse", store, "--as-of", "2026-02-11")
    assert done.exit_code == 0, done.output
    done = run("fleet", "report", store, "-o", tmp_path / "pages")
    assert done.exit_code == 0, done.output
    assert sorted(path.suffix for path in (tmp_path / "pages").iterdir()) == [".html", ".html"]
    assert run("fleet", "report", store, "--robot", "unknown").exit_code == 3


def test_commands_name_what_cannot_be_used(tmp_path: Path) -> None:
    rows = checks("one", days=[0, 2, 1])
    (tmp_path / "half.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(100))
    table = write_table(tmp_path / "a.csv", rows)
    done = run("fleet", "ingest", tmp_path / "store", tmp_path / "half.h5", table)
    assert done.exit_code == 3
    assert "3 checks added" in " ".join(done.output.split())
    lines = [text for text in done.output.splitlines() if "half.h5" in text or "clock was set back" in text]
    assert len(lines) == 2
    assert run("fleet", "analyse", tmp_path / "nothing").exit_code == 3
    assert run("fleet", "report", tmp_path / "store").exit_code == 3
    assert run("fleet", "analyse", tmp_path / "store", "--as-of", "soon").exit_code == 2
