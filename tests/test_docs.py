"""Documentation: what the code can write is current, and every link leads somewhere."""

from __future__ import annotations

import re
import shutil
import tomllib
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, metadata, requires
from pathlib import Path

import pytest

from benchmarks.reference import BLOCKS, REFERENCE, kind_in_words, stale
from gateway.cell.config import AxisConfig, Cell
from tests.support.rigs.command_line import PROGRAMS, parse_typed
from tests.system.test_tutorial import blocks

ROOT = Path(__file__).resolve().parents[1]
PAGES_OF_MARKDOWN = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])


def anchors(page: Path) -> set[str]:
    """Anchors that the headings of a page get."""
    headings = re.findall(r"(?m)^#+ (.+)$", re.sub(r"(?s)```.*?```", "", page.read_text(encoding="utf-8")))
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES_OF_MARKDOWN, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    text = re.sub(r"(?s)```.*?```", "", page.read_text(encoding="utf-8"))
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if link.startswith(("http://", "https://", "mailto:")):
            continue
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


def test_every_page_is_reached_from_the_readme() -> None:
    reached, waiting = set(), [ROOT / "README.md"]
    while waiting:
        page = waiting.pop()
        if page in reached or page.suffix != ".md":
            continue
        reached.add(page)
        for link in re.findall(r"\]\(([^)#\s]+)", page.read_text(encoding="utf-8")):
            if "://" not in link:
                waiting.append((page.parent / link).resolve())
    assert set(PAGES_OF_MARKDOWN) <= reached, sorted(map(str, set(PAGES_OF_MARKDOWN) - reached))


@pytest.mark.parametrize("page", PAGES_OF_MARKDOWN, ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_of_a_page_can_be_typed(page: Path) -> None:
    targets = re.findall(r"[\w-]+", (ROOT / "Makefile").read_text(encoding="utf-8").partition(".PHONY: ")[2])
    shown = blocks(page.read_text(encoding="utf-8"))
    lines = [line for block in shown if block.kind in ("", "sh") for line in block.lines]
    assert [line for line in lines if line.startswith("make ") and line.split()[1] not in targets] == []
    for line in filter(re.compile("|".join(PROGRAMS)).match, lines):
        parse_typed(line)


def test_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 150


def test_pages_that_the_code_writes_are_current_and_every_block_is_on_one() -> None:
    assert not stale(), "python -m benchmarks.reference --write"
    text = "".join(page.read_text(encoding="utf-8") for page in REFERENCE.glob("*.md"))
    assert [name for name in BLOCKS if f"<!-- {name} -->" not in text] == []


def test_a_page_that_was_edited_is_not_current(tmp_path: Path) -> None:
    shutil.copytree(REFERENCE, tmp_path, dirs_exist_ok=True)
    assert not stale(tmp_path)
    for name, old, new in (("effects.md", "`base_tilt`", "`tilt`"), ("follow.schema.json", "{", "{ ")):
        page = tmp_path / name
        page.write_text(page.read_text(encoding="utf-8").replace(old, new, 1), encoding="utf-8")
    assert sorted(page.name for page in stale(tmp_path)) == ["effects.md", "follow.schema.json"]


def test_every_key_says_what_it_is() -> None:
    for name in ("keys of a cell file", "keys of a drive profile"):
        assert not re.findall(r"(?m)^\| `\w+` \|  \|.*", BLOCKS[name]())


def test_kinds_are_said_in_words() -> None:
    fields = AxisConfig.model_fields
    assert kind_in_words(fields["position_limit_rad"].annotation) == "2 x number"
    assert kind_in_words(fields["gear_ratio"].annotation) == "table (value, source)"
    assert kind_in_words(fields["jerk_limit_rad_s3"].annotation) == "number"
    assert kind_in_words(Cell.model_fields["bus"].annotation) == "by name: table"


def _requirements(names: list[str]) -> set[str]:
    """Names of all packages that these need, without extras."""
    found: set[str] = set()
    while names:
        name = re.match(r"[\w.-]+", names.pop())[0].lower().replace("_", "-")  # type: ignore[index]
        if name not in found:
            found.add(name)
            with suppress(PackageNotFoundError):  # of another platform or version of Python
                names += [each for each in requires(name) or [] if "extra ==" not in each]
    return found


def test_every_package_that_is_installed_beside_it_is_in_the_notice_with_its_licence() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    notice = (ROOT / "NOTICE").read_text(encoding="utf-8")
    copyleft, _, others = notice.partition("Other licences:")
    for name in _requirements(list(project["dependencies"])):
        try:
            about = metadata(name)
        except PackageNotFoundError:
            assert name in others.lower()
            continue
        licence = about.get("License-Expression") or " ".join(about.get_all("Classifier") or [])
        part = copyleft if "GPL" in licence else others
        assert re.search(rf"(?im)^  {re.escape(name)}\b", part), (name, licence)
