"""Open every page in a headless Chromium, wide, narrow and on paper; count what overlaps or is cut off.

python -m benchmarks.pages [--out out/pages]

Leaves each page as HTML, PNG (1280 and 390 px) and PDF beside `summary.json`. Needs the Debian packages chromium,
chromium-driver and poppler-utils.
"""

from __future__ import annotations

import sys
from dataclasses import asdict

from benchmarks.figure import conclude, figure
from benchmarks.program import options
from tests.support.pages.browser import BrowserMissing, browser
from tests.support.pages.faults import Fault, faults_of
from tests.support.pages.samples import PAGES


def main() -> int:
    """Exit 1 when a goal is missed."""
    arguments = options(__doc__, "out/pages").parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    found: list[Fault] = []
    try:
        with browser() as window:
            for name, page in PAGES.items():
                file = arguments.out / f"{name}.html"
                file.write_text(page(), encoding="utf-8")
                found += faults_of(window, file)
    except BrowserMissing as error:
        print(error, file=sys.stderr)
        return 1
    for fault in found:
        print(f"{fault.page}, {fault.layout}: {fault.kind}: {fault.what} at {fault.where}", file=sys.stderr)
    figures = {"pages opened in three layouts": figure(len(PAGES), ">= 8")}
    for kind in ("overlap", "cut off", "orphan heading"):
        figures[f"elements: {kind}"] = figure(sum(fault.kind == kind for fault in found), "== 0")
    return conclude(figures, arguments.out, faults=[asdict(fault) for fault in found])


if __name__ == "__main__":
    raise SystemExit(main())
