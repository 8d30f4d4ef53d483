"""Open every page in a headless Chromium, wide, narrow and on paper; count what overlaps or is cut off.

python -m benchmarks.pages [--out out/pages] [RESULT.json ...]

Leaves each page as HTML, PNG (1280 and 390 px) and PDF beside `summary.json`. Needs the Debian packages chromium,
chromium-driver and poppler-utils.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from dataclasses import asdict, dataclass
from itertools import chain
from pathlib import Path

from benchmarks.bench.__main__ import show
from benchmarks.figure import figure
from benchmarks.pages.browser import PDF_READER, Browser, BrowserMissing, browser
from benchmarks.pages.fleet import fleet_pages
from benchmarks.pages.samples import pages

FAULTS = Path(__file__).with_name("faults.js").read_text(encoding="utf-8")
#: A4 less the margins of the style sheet (12 mm each), at 96 px an inch.
PAPER_PX = 703
WAYS = (("1280", 1280, "screen"), ("390", 390, "screen"), ("paper", PAPER_PX, "print"))
HEIGHT_PX = 900


@dataclass(frozen=True, slots=True)
class Fault:
    """What is wrong on a page in one of the ways of looking at it."""

    page: str
    way: str
    kind: str
    what: str
    where: str


def main(argv: list[str]) -> int:
    """Exit 1 when a goal is missed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.pages", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/pages"))
    parser.add_argument("results", type=Path, nargs="*", help="result files, each of them a further page")
    arguments = parser.parse_args(argv)
    arguments.out.mkdir(parents=True, exist_ok=True)
    found: list[Fault] = []
    opened = 0
    try:
        with browser() as window:
            for name, text in chain(pages(arguments.results), fleet_pages()):
                file = arguments.out / f"{name}.html"
                file.write_text(text, encoding="utf-8")
                found += faults_of(window, file)
                opened += 1
    except BrowserMissing as error:
        print(error, file=sys.stderr)
        return 1
    for fault in found:
        print(f"{fault.page}, {fault.way}: {fault.kind}: {fault.what} at {fault.where}", file=sys.stderr)
    figures = {"pages opened in three ways": figure(opened, ">= 8")}
    for kind in ("overlap", "cut off", "orphan heading"):
        figures[f"elements: {kind}"] = figure(sum(fault.kind == kind for fault in found), "== 0")
    show(figures)
    summary = {"figures": figures, "faults": [asdict(fault) for fault in found]}
    (arguments.out / "summary.json").write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    return 0 if all(entry["met"] for entry in figures.values()) else 1


def faults_of(window: Browser, file: Path) -> list[Fault]:
    """Everything that is wrong with one page; its pictures are left beside it."""
    found = []
    for way, width_px, medium in WAYS:
        window.as_on(medium)
        window.resize(width_px, HEIGHT_PX)
        window.open(file)
        found += [Fault(file.stem, way, **fault) for fault in window.run(FAULTS)]
        if medium == "screen":
            window.picture(file.with_suffix(f".{way}.png"))
    headings = set(window.run("return [...document.querySelectorAll('h2, h3')].map(e => e.textContent)"))
    window.paper(file.with_suffix(".pdf"))
    return found + [
        Fault(file.stem, "paper", "orphan heading", line, f"end of page {number}")
        for number, line in _last_lines(file.with_suffix(".pdf"))
        if line in headings
    ]


def _last_lines(file: Path) -> list[tuple[int, str]]:
    """Last line of every page of a PDF but the last."""
    text = subprocess.run([PDF_READER, "-layout", str(file), "-"], capture_output=True, text=True, check=True).stdout
    sheets = [[line.strip() for line in sheet.splitlines() if line.strip()] for sheet in text.split("\f")]
    return [(number, lines[-1]) for number, lines in enumerate(sheets[:-2], start=1) if lines]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
