"""Whether a wrong load is accepted, what a load costs, and whether a replay differs.

python -m benchmarks.certify [--arms 200] [--replays 10] [--paths 20] [--drifts 60]
                            [--drives 20] [--jobs 1] [--out out/certify]

Arms of `benchmarks.conflict`: torque by pinocchio, friction, gears and noise of their own.

- Acceptance: a load is identified from twelve poses of each arm with `estimate`. Half of the arms get an error that
  reaches twice the tolerance somewhere in the workspace. The errors are another mass or centre of the
  load, a spring, a cable, a tilted base, a shifted joint zero, a hose on the forearm, a changed gain. The poses of the
  design of `accept` are measured with other friction and noise, and `accept --from` decides.
- Replay: stored measurements are computed again with another number of threads.
- Temperature: mass with a drift by recorded temperatures, against time alone.
- Timing: figures of `check --timing` in real time against the truth, defects of drives found, false alarms.
- Load cost: cycle times of `cost` on drawn paths against a search with pinocchio, and the time-optimal bound.
"""

from __future__ import annotations

from benchmarks.program import one_thread, options, run


def main() -> int:
    """Exit 1 when a goal is missed."""
    parser = options(__doc__, "out/certify", jobs=1)
    parser.add_argument("--arms", type=int, default=200)
    parser.add_argument("--replays", type=int, default=10)
    parser.add_argument("--paths", type=int, default=20)
    parser.add_argument("--drifts", type=int, default=60)
    parser.add_argument("--drives", type=int, default=20)
    arguments = parser.parse_args()
    one_thread()
    from benchmarks.certify.acceptance import acceptance_figures, accepted_arm
    from benchmarks.certify.drive_test import measure_drives
    from benchmarks.certify.load_cost import cost_figures, cost_of_path
    from benchmarks.certify.replays import replay_figures, replayed
    from benchmarks.certify.temperature import drifting_arm, temperature_figures
    from benchmarks.figure import conclude

    out = arguments.out
    figures = acceptance_figures(run(accepted_arm, range(arguments.arms), arguments.jobs, out / "arms.jsonl"))
    figures |= replay_figures(run(replayed, range(arguments.replays), arguments.jobs, out / "replays.jsonl"))
    figures |= cost_figures(run(cost_of_path, range(arguments.paths), arguments.jobs, out / "paths.jsonl"))
    figures |= temperature_figures(run(drifting_arm, range(arguments.drifts), arguments.jobs, out / "drifts.jsonl"))
    if arguments.drives:
        figures |= measure_drives(arguments.drives, out, "real")
    return conclude(figures, out)


if __name__ == "__main__":
    raise SystemExit(main())
