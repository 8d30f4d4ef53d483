"""What overlaps or is cut off on a page, as a headless Chromium lays it out."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from pathlib import Path

from tests.support.pages.browser import PDF_READER, Browser

FAULTS = Path(__file__).with_name("faults.js").read_text(encoding="utf-8")
#: A4 less the margins of the style sheet (12 mm each), at 96 px an inch.
PAPER_PX = 703
HEIGHT_PX = 900
MEDIA = (("1280", 1280, "screen"), ("390", 390, "screen"), ("paper", PAPER_PX, "print"))


@dataclass(frozen=True, slots=True)
class Fault:
    """What is wrong on a page in one of the ways of looking at it."""

    page: str
    layout: str
    kind: str
    what: str
    where: str


def faults_of(window: Browser, file: Path) -> list[Fault]:
    """Everything that is wrong with one page; its pictures are left beside it."""
    found = []
    for layout, width_px, medium in MEDIA:
        window.as_on(medium)
        window.resize(width_px, HEIGHT_PX)
        window.open(file)
        found += [Fault(file.stem, layout, **fault) for fault in window.run(FAULTS)]
        if medium == "screen":
            window.picture(file.with_suffix(f".{layout}.png"))
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
