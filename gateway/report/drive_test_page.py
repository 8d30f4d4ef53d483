"""Page of a drive test: one table of figures over all drives."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from gateway.report.page import Head, page
from gateway.result.drive_test import DriveTestReport, TimingFigure
from gateway.result.numerals import significant

#: Text, factor and unit of each figure for a reader, in the order of the page.
SHOWN: Final[dict[str, tuple[str, float, str]]] = {
    "controlword_to_reaction_s": ("Controlword to reaction", 1e3, "ms"),
    "sync_to_tpdo_s": ("SYNC to TPDO, median", 1e3, "ms"),
    "sync_to_tpdo_p05_s": ("SYNC to TPDO, 5 % quantile", 1e3, "ms"),
    "sync_to_tpdo_p95_s": ("SYNC to TPDO, 95 % quantile", 1e3, "ms"),
    "torque_age_s": ("Age of the torque word", 1e3, "ms"),
    "heartbeat_loss_to_standstill_s": ("Heartbeat loss to standstill", 1e3, "ms"),
    "quick_stop_time_s": ("Quick stop, time", 1e3, "ms"),
    "quick_stop_angle_rad": ("Quick stop, angle", 1e3, "mrad"),
    "fault_reaction_time_s": ("Fault reaction to standstill", 1e3, "ms"),
    "missed_pdo_2ms": ("Missed TPDOs at 2 ms", 1e2, "%"),
    "late_pdo_2ms": ("Delayed TPDOs at 2 ms", 1e2, "%"),
    "missed_pdo_4ms": ("Missed TPDOs at 4 ms", 1e2, "%"),
    "late_pdo_4ms": ("Delayed TPDOs at 4 ms", 1e2, "%"),
    "missed_pdo_10ms": ("Missed TPDOs at 10 ms", 1e2, "%"),
    "late_pdo_10ms": ("Delayed TPDOs at 10 ms", 1e2, "%"),
}


def render_drive_test(cell: str, created: str, reports: Sequence[DriveTestReport]) -> str:
    """Return the HTML page of the drives of one arm."""
    failed = [report for report in reports if report.findings]
    measured = [report for report in reports if any(figure.value is not None for figure in report.figures)]
    good = f"{len(measured)} of {len(reports)} drives tested, nothing found"
    names = ", ".join(report.axis for report in failed)
    rows: list[list[str]] = []
    methods: list[tuple[str, str]] = []
    for name, (text, _, unit) in SHOWN.items():
        figures = {report.axis: report.figure(name) for report in reports}
        if not any(figures.values()):
            continue
        rows.append([f"{text} [{unit}]", *map(figure_text, figures.values())])
        axes: dict[str, list[str]] = {}
        for axis, figure in figures.items():
            if figure is not None:
                axes.setdefault(figure.method, []).append(axis)
        methods += [(text, method if len(axes) == 1 else f"{', '.join(who)}: {method}") for method, who in axes.items()]
    return page(
        "drive_test.html.j2",
        Head(f"Drive test: {cell}", "Drive test", (("cell", cell), ("", created))),
        status="bad" if failed else "open" if len(measured) < len(reports) else "good",
        headline=f"{len(failed)} of {len(reports)} drives with findings: {names}" if failed else good,
        findings=[(f"{report.axis} node {report.node}", text) for report in failed for text in report.findings],
        columns=["figure", *(f"{report.axis} (node {report.node})" for report in reports)],
        rows=rows,
        methods=methods,
        drives=[_identity(report) for report in reports],
    )


def figure_text(figure: TimingFigure | None) -> str:
    """Return value and interval of a figure in the unit of `SHOWN`; a dash if it was not measured."""
    if figure is None or figure.value is None or figure.interval is None:
        return "\N{EN DASH}"
    factor = SHOWN[figure.name][1]
    low, high = (significant(factor * end, 2) for end in figure.interval)
    return f"{significant(factor * figure.value, 3)} [{low}, {high}]"


def _identity(report: DriveTestReport) -> tuple[str, ...]:
    def code(key: str) -> str:
        value = report.identity.get(key)
        return "\N{EN DASH}" if value is None else f"0x{value:X}"

    numbers = [code(key) for key in ("vendor", "product", "revision")]
    serial, firmware = report.identity.get("serial"), report.identity.get("firmware")
    texts = ["\N{EN DASH}" if each is None else str(each) for each in (serial, firmware)]
    return (report.axis, str(report.node), *numbers, *texts)
