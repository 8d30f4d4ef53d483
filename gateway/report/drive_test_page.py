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
} | {
    f"{kind}_pdo_{period_ms}ms": (f"{text} TPDOs at {period_ms} ms", 1e2, "%")
    for period_ms in (2, 4, 10)
    for kind, text in (("missed", "Missed"), ("late", "Delayed"))
}


def render_drive_test(cell: str, created: str, reports: Sequence[DriveTestReport]) -> str:
    """Return the HTML page of the drives of one arm."""
    failed = [report for report in reports if report.findings]
    measured = [report for report in reports if any(figure.value is not None for figure in report.figures)]
    good = f"{len(measured)} of {len(reports)} drives tested, nothing found"
    names = ", ".join(report.axis for report in failed)
    rows, methods = list[list[str]](), list[tuple[str, str]]()
    for name, (text, _, unit) in SHOWN.items():
        axes: dict[str, list[str]] = {}
        for report in reports:
            if figure := report.figure(name):
                axes.setdefault(figure.method, []).append(report.axis)
        if not axes:
            continue
        rows.append([f"{text} [{unit}]", *(figure_text(report.figure(name)) for report in reports)])
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
    forms = {"vendor": "0x{:X}", "product": "0x{:X}", "revision": "0x{:X}", "serial": "{}", "firmware": "{}"}
    values = [(form, report.identity.get(key)) for key, form in forms.items()]
    texts = ["\N{EN DASH}" if value is None else form.format(value) for form, value in values]
    return (report.axis, str(report.node), *texts)
