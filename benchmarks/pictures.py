"""Pictures of the documentation: taken of pages that are drawn from the results in docs/pictures/sources.

python -m benchmarks.pictures [NAME ..]

Takes the pictures that are not current, or those of the given names, in a headless Chromium. The text `source` in a PNG
(chunk tEXt, ISO/IEC 15948, 11.3.4.3) is the SHA-256 of the page and of its row in `SHOTS`. A picture is current while
that is the checksum of the page as it is drawn now.

The sources are outputs of commands, in numbers of seven digits. `demo`: `make demo`. `plan`, `follow`, `acceptance`,
`live`: these commands on examples/small. The load of `acceptance` is 0.5 kg heavier than entered. `rehearsal`: the
command on examples/large with four effects. `fleet`, `fleet-robot`: ten robots of benchmarks/fleet/plant.py.
`formula`, `decided`: the linkage spring and the undecided cable torque of tests/gateway/diagnose/rest.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import struct
import sys
import tempfile
import time
import zlib
from collections.abc import Callable
from functools import cache, partial
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

from gateway.acquire.plan import MoveTo, Plan
from gateway.acquire.planning import visit_settings
from gateway.cell.config import load_cell
from gateway.commands.plan_view import view_of_plan
from gateway.data.visit import RestPose
from gateway.live.server import page_text
from gateway.model.arm_model import arm_named, arm_robot
from gateway.motion.workspace import workspace_of
from gateway.report.acceptance_map import render_acceptance
from gateway.report.fleet_page import render_fleet
from gateway.report.follow_page import render_follow
from gateway.report.rehearsal_page import render_rehearsal
from gateway.report.render import render
from gateway.result.fleet import read_fleet
from gateway.result.follow import follow_from_json
from gateway.result.origin import Origin
from gateway.result.result import read_result
from tests.support.pages.browser import BrowserMissing, browser

ROOT: Final = Path(__file__).resolve().parents[1]
PICTURES: Final = ROOT / "docs" / "pictures"
SOURCES: Final = PICTURES / "sources"
#: Head of a page whose source states neither date nor program.
ORIGIN: Final = Origin("2026-11-30 22:00 UTC", "servo-gateway 0.1.0")
#: Length of the signature and of the chunk IHDR, behind which a text may stand [bytes].
HEADER: Final = 33
KEYWORD: Final = b"source\0"
#: Until the scripts of a page have drawn [s].
DRAWN_S: Final = 1.0
#: Hide what is neither in a wanted part, nor around one, nor its heading; return top and bottom of the rest [px].
SHOW: Final = """const parts = [...document.querySelectorAll(PARTS)].map((part) => part.closest("figure") ?? part);
for (const part of [...parts]) {
  let above = part.closest("main > *")?.previousElementSibling;
  for (; above?.matches("h2, .lead, .key"); above = above.previousElementSibling) parts.push(above);
}
for (const each of document.querySelectorAll("main *"))
  if (!parts.some((part) => part.contains(each) || each.contains(part))) each.style.display = "none";
const top = Math.min(...parts.map((part) => part.getBoundingClientRect().top));
return [Math.max(0, top - 14), document.querySelector("main").getBoundingClientRect().bottom];"""


def source(name: str) -> Any:
    """Values of a stored source."""
    return json.loads((SOURCES / f"{name}.json").read_text(encoding="utf-8"))


@cache
def result(name: str) -> str:
    """Report of a stored result."""
    return render(read_result(SOURCES / f"{name}.json"))


def plan() -> str:
    """Page of the stored plan of the small cell."""
    stored, loaded = source("plan"), load_cell(ROOT / "examples" / "small" / "cell.toml")
    config = arm_named(loaded, stored["arm"])
    poses = tuple(RestPose(pose["pose"], tuple(pose["q_rad"]), pose["purpose"]) for pose in stored["poses"])
    steps = tuple(MoveTo(tuple(corner)) for corner in stored["corners_rad"])
    chosen = Plan(config.name, poses, visit_settings(loaded, config), None, steps, 0.0)
    return view_of_plan(chosen, workspace_of(config, arm_robot(loaded, config)))


def live() -> str:
    """The live page with its styles and scripts inside, which receives the stored messages."""

    def inside(found: re.Match[str]) -> str:
        text = files("gateway.live").joinpath("static", found[1]).read_text(encoding="utf-8")
        return f"<style>{text}</style>" if found[1].endswith(".css") else f"<script>{text}</script>"

    page = re.sub(r"<(?:link|script)[^>]*/static/([\w.]+)[^>]*>(?:</script>)?", inside, page_text("token"))
    sent = json.dumps(source("live")).replace("</", "<\\/")
    return f"{page}<script>connect = arm_button; live.socket = {{ readyState: 1 }}; {sent}.forEach(receive);</script>"


#: Name: page, CSS selector of its parts, width and largest height [px], pixels of the picture a px.
SHOTS: Final[dict[str, tuple[Callable[[], str], str, int, int, float]]] = {
    "report": (partial(result, "demo"), "main", 1280, 1425, 1.0),
    "certificate": (partial(result, "demo"), ".certificate", 1000, 900, 1.0),
    "residual-and-effects": (
        partial(result, "demo"),
        "[aria-label^=Held-out], [aria-label*='J2 against']",
        480,
        800,
        2.0,
    ),
    "torque-by-pose": (partial(result, "demo"), "[aria-label^='Torque of J2']", 480, 600, 2.0),
    "formula": (partial(result, "formula"), ".effect:has([aria-label*=formula])", 1280, 900, 1.0),
    "decided": (partial(result, "decided"), ".verdict, .card, .first > div:last-child", 1280, 900, 1.0),
    "acceptance": (lambda: render_acceptance(source("acceptance"), ORIGIN), "main", 1000, 1140, 1.0),
    "rehearsal": (lambda: render_rehearsal(source("rehearsal"), ORIGIN), "main", 1120, 1640, 1.0),
    "follow": (
        lambda: render_follow(follow_from_json(json.dumps(source("follow")), "follow")),
        "main",
        1200,
        1465,
        1.0,
    ),
    "fleet": (lambda: render_fleet(read_fleet(SOURCES / "fleet.json")), "main", 1280, 1200, 1.0),
    "plan": (plan, "main", 1000, 1394, 1.0),
    "live": (live, "main", 1280, 1500, 1.0),
}


def checksum(name: str) -> str:
    """SHA-256 of the page of a picture and of what is shown of it."""
    page, *shown = SHOTS[name]
    return hashlib.sha256(json.dumps([page(), *shown]).encode()).hexdigest()


def with_source(png: bytes, text: str) -> bytes:
    """PNG with the text `source` behind its header."""
    body = b"tEXt" + KEYWORD + text.encode()
    chunk = struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
    return png[:HEADER] + chunk + png[HEADER:]


def source_of(png: bytes) -> str:
    """The text `source` of a PNG, empty without one."""
    found = re.match(rb"(?s).{33}....tEXtsource\0([0-9a-f]{64})", png)
    return found[1].decode() if found else ""


def stale(folder: Path = PICTURES) -> list[str]:
    """Names of the pictures that are missing, or not of the page as it is drawn now."""
    return [
        name
        for name in SHOTS
        if not (file := folder / f"{name}.png").exists() or source_of(file.read_bytes()) != checksum(name)
    ]


def take(names: list[str]) -> None:
    """Write pictures."""
    with browser() as window, tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "page.html"
        for name in names:
            page, parts, width_px, most_px, scale = SHOTS[name]
            file.write_text(page(), encoding="utf-8")
            window.resize(width_px, most_px, scale=scale)
            window.in_light("light")
            window.open(file)
            top_px, bottom_px = window.run(SHOW.replace("PARTS", json.dumps(parts)))
            time.sleep(DRAWN_S)
            picture = PICTURES / f"{name}.png"
            window.picture(
                picture, {"x": 0, "y": top_px, "width": width_px, "height": min(bottom_px - top_px, most_px)}
            )
            picture.write_bytes(with_source(picture.read_bytes(), checksum(name)))
            print(picture.relative_to(ROOT))


def main() -> int:
    """Exit 1 without a browser."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.pictures", description=__doc__)
    parser.add_argument("names", nargs="*", choices=[*SHOTS, []], metavar="NAME")
    try:
        take(parser.parse_args().names or stale())
    except BrowserMissing as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
