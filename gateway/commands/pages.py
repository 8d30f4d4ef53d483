"""Pages as files: HTML as it is, PDF printed by an installed browser."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Final

from drives.files import replace_file
from gateway.errors import ConfigError

#: Browsers that print a page without a window, by the names that they are installed under.
BROWSERS: Final = (
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "chrome",
    "msedge",
    "microsoft-edge",
)
#: Places where they are installed beside the search path: macOS, Windows.
PLACES: Final = (
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
    "/Applications/Chromium.app/Contents/MacOS/Chromium",
    r"C:\Program Files\Google\Chrome\Application\chrome.exe",
    r"C:\Program Files (x86)\Microsoft\Edge\Application\msedge.exe",
)
#: Within which a page has to be printed [s]: a browser starts in 1 to 5 s.
PATIENCE_S: Final = 120.0


def find_browser() -> str | None:
    """Path of an installed browser that prints PDF; None = there is none."""
    for name in BROWSERS:
        found = shutil.which(name)
        if found is not None:
            return found
    return next((place for place in PLACES if Path(place).is_file()), None)


def write_page(path: Path, html: str) -> None:
    """Write a page; as PDF where the name ends with `.pdf`.

    Raises
    ------
    ConfigError
        A PDF is asked for, and no browser is installed or it does not print.
    """
    if path.suffix.lower() != ".pdf":
        replace_file(path, html)
        return
    browser, instead = find_browser(), path.with_suffix(".html")
    if browser is None:
        raise ConfigError(
            f"{path}: a PDF is printed by a browser, and neither {', '.join(BROWSERS[:3])} nor another is installed:"
            f" install chromium, or write {instead} and print it from any browser"
        )
    replace_file(path, _printed(browser, html, path))


def _printed(browser: str, html: str, path: Path) -> bytes:
    """PDF of a page."""
    with tempfile.TemporaryDirectory(prefix="servo-gateway-") as folder:
        page, pdf = Path(folder, "page.html"), Path(folder, "page.pdf")
        page.write_text(html, encoding="utf-8")
        words = [browser, "--headless", "--disable-gpu", "--no-pdf-header-footer", f"--user-data-dir={folder}/profile"]
        if hasattr(os, "geteuid") and os.geteuid() == 0:
            words.append("--no-sandbox")  # root has no sandbox; the page is our own and fetches nothing
        try:
            done = subprocess.run(
                [*words, f"--print-to-pdf={pdf}", page.as_uri()], capture_output=True, check=False, timeout=PATIENCE_S
            )
            content = pdf.read_bytes() if pdf.is_file() else b""
        except (OSError, subprocess.TimeoutExpired) as error:
            raise ConfigError(f"{path}: {browser} did not print the page: {error}; write {path.stem}.html") from error
    if not content.startswith(b"%PDF"):
        last = done.stderr.decode(errors="replace").strip().splitlines()[-1:] or ["nothing was said"]
        raise ConfigError(f"{path}: {browser} printed no PDF ({last[0]}); write {path.stem}.html, and print that")
    return content
