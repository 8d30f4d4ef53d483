"""Write pages as HTML, or as PDF printed by an installed browser."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Final

from drives.files import replace_file
from gateway.errors import ConfigError

#: Program names of browsers that can print without a window.
BROWSERS: Final = (
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "chrome",
    "msedge",
    "microsoft-edge",
)
#: Installation paths outside the search path: macOS, Windows.
PLACES: Final = (
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
    "/Applications/Chromium.app/Contents/MacOS/Chromium",
    r"C:\Program Files\Google\Chrome\Application\chrome.exe",
    r"C:\Program Files (x86)\Microsoft\Edge\Application\msedge.exe",
)
#: Time limit for printing a page [s]; a browser starts in 1 to 5 s.
PATIENCE_S: Final = 120.0


def find_browser() -> str | None:
    """Return the path of an installed browser that prints PDF, or None."""
    for name in BROWSERS:
        found = shutil.which(name)
        if found is not None:
            return found
    return next((place for place in PLACES if Path(place).is_file()), None)


def write_page(path: Path, html: str) -> None:
    """Write a page; as PDF if the name ends with `.pdf`.

    Raises
    ------
    ConfigError
        A PDF is requested, but no browser is installed or printing fails.
    """
    if path.suffix.lower() != ".pdf":
        replace_file(path, html)
        return
    browser, instead = find_browser(), path.with_suffix(".html")
    if browser is None:
        raise ConfigError(
            f"{path}: PDF output needs an installed browser ({', '.join(BROWSERS[:3])} or similar): install "
            f"chromium, or write {instead} and print it from any browser"
        )
    with tempfile.TemporaryDirectory(prefix="servo-gateway-") as folder:
        page, pdf = Path(folder, "page.html"), Path(folder, "page.pdf")
        page.write_text(html, encoding="utf-8")
        words = [browser, "--headless", "--disable-gpu", "--no-pdf-header-footer", f"--user-data-dir={folder}/profile"]
        if hasattr(os, "geteuid") and os.geteuid() == 0:
            words.append("--no-sandbox")  # root has no sandbox; the page is generated here and loads nothing
        try:
            done = subprocess.run(
                [*words, f"--print-to-pdf={pdf}", page.as_uri()], capture_output=True, check=False, timeout=PATIENCE_S
            )
            content = pdf.read_bytes() if pdf.is_file() else b""
        except (OSError, subprocess.TimeoutExpired) as error:
            raise ConfigError(f"{path}: {browser} did not print the page: {error}; write {path.stem}.html") from error
    if not content.startswith(b"%PDF"):
        last = done.stderr.decode(errors="replace").strip().splitlines()[-1:] or ["no message"]
        raise ConfigError(f"{path}: {browser} printed no PDF ({last[0]}); write {path.stem}.html, and print that")
    replace_file(path, content)
