"""Data of a fit never passes as validation, however it is renamed, cut or exported again; new visits always do."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from gateway.data.rows import concatenate
from gateway.data.table import read_csv, write_csv
from gateway.result.data_roles import CHOSEN_ON, FIT, VALIDATION, roles_of, shared_rows, used_rows
from gateway.result.result import read_result, to_json
from tests.data.resting_arm import LIMIT, POSES, SMALL, two_sided
from tests.support.rigs.command_line import run
from tests.support.rigs.tables import make_table

TOOL = (4.0, 0.03, 0.02, 0.10)


@pytest.fixture(scope="module")
def identified(tmp_path_factory):
    """A folder with cell, fitted table and result."""
    folder = tmp_path_factory.mktemp("roles")
    for name in ("cell.toml", "robot.urdf"):
        shutil.copy(SMALL / name, folder / name)
    write_csv(concatenate([two_sided("none", None), two_sided("tool", TOOL, start_s=300.0)]), folder / "seen.csv")
    cell = ("--cell", folder / "cell.toml")
    assert run("estimate", folder / "seen.csv", *cell, "--json", folder / "result.json").exit_code == 0
    return folder


def disguised(folder, seed, path):
    """Write fitted visits under load `tool`: cut, shuffled, renamed, with new numbers and times, some beside new ones.

    By seed they have six decimals or six digits, or other torque constants.
    """
    rng = np.random.default_rng([seed, 1])
    table = read_csv(folder / "seen.csv", None)
    table = table.take(rng.permutation(len(table))[: rng.integers(2, len(table) + 1)])
    count = len(table)
    if seed % 3 == 0:
        table = replace(table, q_rad=np.trunc(table.q_rad * 1e6) / 1e6, tau_nm=np.trunc(table.tau_nm * 1e6) / 1e6)
    elif seed % 3 == 1:
        digits = np.vectorize(lambda value: float(f"{value:.6g}"))
        table = replace(table, q_rad=digits(table.q_rad), tau_nm=digits(table.tau_nm))
    if seed % 4 == 3:
        table = table.with_torque_scaled(rng.uniform(0.9, 1.1, 6))
    table = replace(table, run=np.full(count, f"other{seed}"), load=np.full(count, "tool"))
    table = replace(table, pose=500 + rng.permutation(count), time_s=9000.0 + 30.0 * np.arange(count))
    if seed % 2:
        table = concatenate([new_visits(seed, 1), table])
    write_csv(table, path)
    return path


def new_visits(seed, poses=8):
    unseen = np.random.default_rng([seed, 2]).uniform(-LIMIT, LIMIT, (poses, 6))
    return two_sided("tool", TOOL, unseen, 2000.0, seed + 100, first=200)


def accepted(folder, data):
    words = ("accept", folder / "cell.toml", folder / "result.json", "--from", data, "--tolerance", "5%")
    return run(*words, "--json", data.with_suffix(".json"))


TRIES = [range(3), range(3, 5), pytest.param(range(5, 17), marks=pytest.mark.slow)]


def held_out(folder, data):
    return run("diagnose", folder / "seen.csv", "--cell", folder / "cell.toml", "--holdout", data)


@pytest.mark.parametrize("seeds", TRIES)
@pytest.mark.parametrize("judge", [accepted, held_out])
def test_fitted_visits_are_refused_in_every_disguise(identified, tmp_path, judge, seeds):
    for seed in seeds:
        data = disguised(identified, seed, tmp_path / f"{seed}.csv")
        done = judge(identified, data)
        assert done.exit_code == 6, (seed, done.output)
        assert f"{data}:" in done.stderr
        assert "used by the fit" in " ".join(done.stderr.split())


@pytest.mark.parametrize("seeds", TRIES)
def test_new_visits_of_seen_and_unseen_poses_are_judged(identified, tmp_path, seeds):
    roles = read_result(identified / "result.json").data_roles
    for seed in seeds:
        again = two_sided("tool", TOOL, POSES, 4000.0, seed + 100)
        assert not used_rows(concatenate([again, two_sided("none", None, seed=seed + 100)]), roles, (FIT,)).any()
        write_csv(concatenate([new_visits(seed), again]), tmp_path / f"{seed}.csv")
        done = accepted(identified, tmp_path / f"{seed}.csv")
        assert done.exit_code in (0, 7), (seed, done.output)
        assert len(json.loads((tmp_path / f"{seed}.json").read_text())["poses"]) == 8


@pytest.mark.slow
def test_a_diagnosis_states_what_judged_it_and_accept_reports_that(identified, tmp_path):
    write_csv(new_visits(1), tmp_path / "held.csv")
    words = ("diagnose", identified / "seen.csv", "--cell", identified / "cell.toml", "--only", "cable_torque")
    done = run(*words, "--holdout", tmp_path / "held.csv", "--json", tmp_path / "result.json")
    assert done.exit_code in (0, 7), done.output
    roles = read_result(tmp_path / "result.json").data_roles
    assert {role: {label: len(entry["q_rad"]) for label, entry in loads.items()} for role, loads in roles.items()} == {
        FIT: {"none": 20, "tool": 20},
        VALIDATION: {"tool": 16},
    }
    shutil.copy(identified / "cell.toml", tmp_path)
    shutil.copy(identified / "robot.urdf", tmp_path)
    done = accepted(tmp_path, tmp_path / "held.csv")
    assert done.exit_code in (0, 7), done.output
    assert json.loads((tmp_path / "held.json").read_text())["visits_that_judged_before"] == 16
    chosen = replace(read_result(tmp_path / "result.json"), data_roles={CHOSEN_ON: roles[VALIDATION]}, sha256=None)
    (tmp_path / "result.json").write_text(to_json(chosen), encoding="utf-8")
    done = accepted(tmp_path, tmp_path / "held.csv")
    assert done.exit_code == 6, done.output


def test_accept_refuses_a_result_without_roles(identified, tmp_path):
    for name in ("cell.toml", "robot.urdf"):
        shutil.copy(identified / name, tmp_path)
    result = replace(read_result(identified / "result.json"), data_roles={}, sha256=None)
    (tmp_path / "result.json").write_text(to_json(result), encoding="utf-8")
    write_csv(new_visits(1), tmp_path / "new.csv")
    done = accepted(tmp_path, tmp_path / "new.csv")
    assert done.exit_code == 6
    assert "estimate again" in done.stderr


def test_compare_counts_shared_visits(identified, tmp_path):
    first, other = identified / "result.json", tmp_path / "other.json"
    again = concatenate([two_sided("none", None), two_sided("tool", TOOL, start_s=900.0, seed=9)])
    write_csv(again, tmp_path / "again.csv")
    assert run("estimate", tmp_path / "again.csv", "--cell", identified / "cell.toml", "--json", other).exit_code == 0
    for file, shared in ((other, {"none": 20}), (first, {"none": 20, "tool": 20})):
        done = run("compare", first, file, "--json", tmp_path / "compared.json")
        assert done.exit_code in (0, 7), done.output
        body = json.loads((tmp_path / "compared.json").read_text())
        assert body["shared"] == {"visits": shared, "moving_samples": {}, "all": file == first}
        assert any("same data" in remark for remark in body["remarks"]) == (file == first)


def test_a_part_of_a_long_run_is_recognised_by_few_rows():
    """256 of 64 000 rows are kept; of a tenth of the run, another 256 that include those of the run in it."""
    rng, count = np.random.default_rng(3), 64000
    q = np.cumsum(rng.normal(0.0, 0.004, (count, 6)), axis=0)
    run_rows = make_table(
        ["a"] * count, np.full(count, -1), q, rng.normal(0.0, 50.0, (count, 6)), time=np.arange(count)
    )
    whole, part = roles_of(run_rows), roles_of(run_rows.take(np.arange(20000, 26400)))
    assert len(whole[FIT]["a"]["moving_q_rad"]) == 256
    assert len(json.dumps(whole)) < 60000
    shared = shared_rows(whole, part)["moving_samples"]["a"]
    assert 15 <= shared <= 40
    other = make_table(["a"] * count, np.full(count, -1), q, rng.normal(0.0, 50.0, (count, 6)), time=np.arange(count))
    assert shared_rows(whole, roles_of(other))["moving_samples"] == {}
