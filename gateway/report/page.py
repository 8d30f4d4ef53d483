"""The shell of every page: one file with the same styles, head and foot, that fetches nothing when it opens."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from gateway.report import words


@dataclass(frozen=True, slots=True)
class Head:
    """What stands at the top: `title` of the window, `heading`, and `about`: pairs of a word and what it is."""

    title: str
    heading: str
    about: Sequence[tuple[str, str | None]]


def page(template: str, head: Head, **values: Any) -> str:
    """HTML text of a page.

    Parameters
    ----------
    template : str
        A template of this folder that extends `page.html.j2`.
    head : Head
    values
        What the template names.
    """
    environment = Environment(
        loader=PackageLoader("gateway", "report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    filters: dict[str, Any] = environment.filters
    filters.update(significant=words.significant, rounded=words.rounded, known=words.known)
    style = files("gateway.report").joinpath("report.css").read_text(encoding="utf-8")
    return environment.get_template(template).render(head=head, css=Markup(style), **values)
