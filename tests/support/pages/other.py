"""A comparison and the runs of a pair, small but whole, as the commands hand them to their pages."""

import math

from gateway.report.comparison_page import render_repeatability
from gateway.report.pair_page import FORCE, GAP, Limited, render_pair
from gateway.result.drawn import Drawn
from gateway.result.follow import (
    AxisSources,
    ErrorCurve,
    FedLoad,
    FedModel,
    FedTrend,
    FollowedPath,
    FollowedSetting,
    FollowResult,
    FollowSeries,
    PeakRatio,
    TorqueCurve,
    TrendCloud,
)
from gateway.result.pair import CycleSummary, PairRunResult
from gateway.result.repeatability import repeatability
from gateway.result.result import LoadResult, Result

SIX = (0.0157, 0.0167, 0.0167, 0.0176, 0.0228, 0.0317)


def comparison(robot="qh165"):
    load = FedLoad("tool", 69.9, 0.1, (0.05, -0.02, 0.22), "link_6", ((1.0, 0.0, 0.0),) * 3, "r.json", "assumed")
    scaled = {"off": 1.0, "maximum": 0.1, "identified": 0.01}
    return FollowResult(
        robot=robot,
        cell="large",
        arm="main",
        path=FollowedPath("swing", "path.toml", 7.7, 0.004),
        settings=tuple(
            FollowedSetting(name, None if name == "off" else load, *(tuple(k * v for v in SIX),) * 4)
            for name, k in scaled.items()
        ),
        ratio=PeakRatio({}, None),
        trend=FedTrend(0.2, 0.01, 83.0, 1.0, (0.05, -0.02, 0.22), (0.01, 0.01, 0.01), SIX),
        model=FedModel("robot model", (AxisSources("assumed", "assumed", "assumed", "assumed", "1"),) * 6),
        computing_s=None,
        left_out_syncs=0,
        findings=(),
        series=FollowSeries(
            {name: ErrorCurve((0.0, 1.0, 2.0), ((0.0, math.nan, k * 0.01),) * 6) for name, k in scaled.items()},
            (TorqueCurve(2, (0.0, 1.0), (3.0, math.nan), (3.0, 4.0)),),
            (TrendCloud(2, (700.0, 900.0), (140.0, 180.0)),),
        ),
    )


def run(name="C8", **along):
    cycles = tuple(
        CycleSummary(cycle=number, knots=9 + number, force_n=60.0 / number, moment_nm=2.0, gap_m=3e-4 / number)
        for number in (1, 2, 3)
    )
    return PairRunResult(
        name=name, text="learned on the run", speed=1.5, s_m=(0.0, 0.5), x_m=(0.7, 0.9), knots_s_m=(0.0,),
        cycles=cycles, **along,
    )  # fmt: skip


def forces(name="C8", origin=None):
    return render_pair(
        "pair",
        Limited(FORCE, 40.0, "as estimated"),
        [run(name, first_n=(0.0, 0.0), last_n=(0.0, -12.0), first_size_n=(0.0, 60.0), last_size_n=(0.0, 20.0))],
        origin,
    )


def gaps():
    runs = [run(first_m=(0.0, 3e-4), last_m=(0.0, math.nan))]
    return render_pair("gap", Limited(GAP, 1e-3, "as measured"), runs)


def repetitions(count=20):
    """One load over three days; the seventh measurement is far from the others."""
    common = {"gain": ((0.1,), (1e-4,), (1e-4,), (2e-4,))}
    results = []
    for k in range(count):
        away = 6.0 if k == 6 else math.sin(2.0 * k)
        com_m = tuple(
            value + 1e-3 * away * part for value, part in zip((0.05, -0.02, 0.22), (0.5, 0.3, 1.0), strict=True)
        )
        load = LoadResult("tool", 25.0 + 0.05 * away, 0.12, com_m, (6e-4, 4e-4, 1e-3), common_errors=common)
        created = f"2026-03-{11 + 3 * k // count} 10:{k:02d} UTC"
        results.append(Result("qh165", (load,), data=Drawn(created=created)))
    return render_repeatability(repeatability(results, [f"out/{k:02d}/result.json" for k in range(1, count + 1)]))
