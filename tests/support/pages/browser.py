"""A headless Chromium, led through chromedriver by the WebDriver protocol: no library is needed for so little of it.

W3C WebDriver (endpoints), `goog/cdp/execute` of chromedriver for what DevTools alone can do.
"""

from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess
import tempfile
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

DRIVER = "chromedriver"
PDF_READER = "pdftotext"
MISSING = f"{DRIVER}, chromium or {PDF_READER} is missing: apt-get install chromium chromium-driver poppler-utils"
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
ARGUMENTS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
)
#: A page is static and small; a browser that takes longer has stalled.
PATIENCE_S = 60.0
_READY = re.compile(r"started successfully on port (\d+)")


class BrowserMissing(RuntimeError):  # noqa: N818 - reads as what happened
    """There is no Chromium with its driver on this machine."""


@dataclass(frozen=True, slots=True)
class Browser:
    """One window; `address` is that of its session."""

    address: str

    def open(self, file: Path) -> None:
        """Load a page from disk."""
        self.visit(file.resolve().as_uri())

    def visit(self, address: str) -> None:
        """Load a page from wherever it is."""
        self._ask("url", {"url": address})

    def in_light(self, scheme: str) -> None:
        """Use the styles of a `light` or a `dark` desktop."""
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        self.devtools("Emulation.setEmulatedMedia", {"media": "screen", "features": features})

    def resize(self, width_px: int, height_px: int, *, scale: float = 1.0) -> None:
        """Lay out as on a screen of that width, whatever window there is."""
        size = {"width": width_px, "height": height_px, "deviceScaleFactor": scale, "mobile": False}
        self.devtools("Emulation.setDeviceMetricsOverride", size)

    def as_on(self, medium: str) -> None:
        """Use the styles of `screen` or `print`."""
        self.devtools("Emulation.setEmulatedMedia", {"media": medium})

    def run(self, script: str) -> Any:
        """What a script returns."""
        return self._ask("execute/sync", {"script": script, "args": []})

    def picture(self, file: Path, clip: dict[str, float] | None = None) -> None:
        """Write the whole page as PNG, or its part `x`, `y`, `width`, `height` [px]."""
        part = {"clip": {**clip, "scale": 1.0}} if clip else {}
        shot = self.devtools("Page.captureScreenshot", {"format": "png", "captureBeyondViewport": True, **part})
        file.write_bytes(base64.b64decode(shot["data"]))

    def paper(self, file: Path) -> None:
        """Write the page as PDF, on the paper that its styles ask for."""
        printed = self.devtools("Page.printToPDF", {"preferCSSPageSize": True, "printBackground": True})
        file.write_bytes(base64.b64decode(printed["data"]))

    def devtools(self, command: str, parameters: dict[str, Any]) -> Any:
        """Ask DevTools."""
        return self._ask("goog/cdp/execute", {"cmd": command, "params": parameters})

    def _ask(self, what: str, body: dict[str, Any]) -> Any:
        return _post(f"{self.address}/{what}", body)


def available() -> bool:
    """Whether a browser can be started here, and what it prints be read."""
    return all(map(shutil.which, (DRIVER, PDF_READER))) and any(map(shutil.which, BROWSERS))


@contextmanager
def browser() -> Iterator[Browser]:
    """A browser with a profile of its own, gone afterwards.

    Raises
    ------
    BrowserMissing
        Says what to install.
    """
    if not available():
        raise BrowserMissing(MISSING)
    with tempfile.TemporaryDirectory() as profile:
        program = subprocess.Popen([DRIVER, "--port=0"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        try:
            address = f"http://127.0.0.1:{_port(program)}/session"
            options = {"args": [*ARGUMENTS, f"--user-data-dir={profile}"]}
            wanted = {"capabilities": {"alwaysMatch": {"browserName": "chrome", "goog:chromeOptions": options}}}
            session = f"{address}/{_post(address, wanted)['sessionId']}"
            try:
                yield Browser(session)
            finally:
                urllib.request.urlopen(urllib.request.Request(session, method="DELETE"), timeout=PATIENCE_S).close()
        finally:
            program.terminate()
            program.communicate()


def _port(program: subprocess.Popen[str]) -> int:
    for line in program.stdout or ():
        if found := _READY.search(line):
            return int(found[1])
    raise BrowserMissing(f"{DRIVER} does not start")


def _post(address: str, body: dict[str, Any]) -> Any:
    request = urllib.request.Request(address, json.dumps(body).encode(), {"Content-Type": "application/json"})
    try:
        with urllib.request.urlopen(request, timeout=PATIENCE_S) as answer:
            return json.loads(answer.read())["value"]
    except urllib.error.HTTPError as error:
        raise RuntimeError(f"{address}: {json.loads(error.read())['value']['message']}") from error
