"""Frame of every page: one file with common styles, head and foot; it loads nothing when opened."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from gateway.report import notation
from gateway.result.finding import Finding
from gateway.result.numerals import with_degrees
from gateway.result.origin import DriveOrigin, Origin


@dataclass(frozen=True, slots=True)
class Head:
    """Page head: window `title`, `heading`, and `about` (pairs of name and value)."""

    title: str
    heading: str
    about: Sequence[tuple[str, str | None]]


def status_of(findings: Sequence[Finding]) -> str:
    """Return the colour of a page's head: `bad` with a failing finding, `open` with a warning, otherwise `good`."""
    severities = {finding.severity for finding in findings}
    return "bad" if "fail" in severities else "open" if "warn" in severities else "good"


def made(origin: Origin | None) -> tuple[tuple[str, str | None], ...]:
    """Return date and program for the page head."""
    return () if origin is None else (("", origin.created), ("", origin.software))


def drive_rows(drives: Sequence[DriveOrigin]) -> list[tuple[str, ...]]:
    """Return table rows of the drives; a dash for unknown values."""
    return [
        (
            notation.axis(drive.joint),
            str(drive.node_id),
            *(
                notation.plain(None) if text is None else text
                for text in (
                    drive.name,
                    _codes(drive),
                    None if drive.serial_number is None else str(drive.serial_number),
                    drive.software_version,
                    drive.hardware_version,
                )
            ),
        )
        for drive in drives
    ]


def _codes(drive: DriveOrigin) -> str | None:
    codes = [f"0x{code:X}" for code in (drive.vendor_id, drive.product_code) if code is not None]
    return ", ".join(codes) or None


def page(template: str, head: Head, **values: Any) -> str:
    """Return an HTML page.

    Parameters
    ----------
    template : str
        A template of this folder that extends `page.html.j2`.
    head : Head
    values
        Variables of the template.
    """
    environment = Environment(
        loader=PackageLoader("gateway", "report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    filters: dict[str, Any] = environment.filters
    filters.update(
        significant=notation.significant, rounded=notation.rounded, known=notation.known, degrees=with_degrees
    )
    style = files("gateway.report").joinpath("report.css").read_text(encoding="utf-8")
    return environment.get_template(template).render(head=head, css=Markup(style), **values)
