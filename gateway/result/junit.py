"""Acceptance as a JUnit file for build servers.

One test case per declared load (is it mounted?), per expectation and rating, and per further failing finding. A
failed load and an undecided one are both failures, with different `type`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Final
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from drives.printable import one_line
from gateway.result.acceptance import PASS, acceptance_findings, asked_for, measured, not_hung
from gateway.result.numerals import SAID, with_interval
from gateway.result.result import Finding, Result

NAME: Final = "servo-gateway"
#: Duration of every test case: not measured.
_NO_TIME: Final = "0.000"


@dataclass(frozen=True, slots=True)
class Case:
    """One test case: `kind` and `why` of its failure, both empty if it passed."""

    group: str
    name: str
    kind: str = ""
    why: str = ""


def cases(result: Result) -> tuple[Case, ...]:
    """Return all test cases of a result."""
    return tuple(_cases(result))


def _cases(result: Result) -> Iterator[Case]:
    reported: set[Finding] = set()
    for load in result.loads:
        doubts = not_hung([load])
        reported.update(doubts)
        found = f"{with_interval(load.mass_kg, load.mass_std_kg)} kg ({SAID})"
        yield _case(f"load {load.label}", f"mass differs from zero: {found}", "not hung", doubts)
    for row in result.acceptance:
        failed = acceptance_findings([row])
        reported.update(failed)
        name = f"{row.what} {measured(row)} ({SAID}), allowed: {asked_for(row)}"
        yield _case(f"load {row.load}", name, PASS if row.outcome == PASS else row.outcome, failed)
    for finding in result.findings:
        if finding.severity == "fail" and finding not in reported:
            yield _case(finding.where, finding.what, "finding", (finding,))


def _case(group: str, name: str, kind: str, failed: tuple[Finding, ...]) -> Case:
    if not failed:
        return Case(group, name)
    return Case(group, name, kind, "; ".join(f"{each.what}; {each.advice}" for each in failed))


def junit(result: Result, moment: datetime) -> str:
    """Return the text of the JUnit file of a result.

    Parameters
    ----------
    result : Result
        With its acceptance.
    moment : datetime
        Of the analysis.
    """
    return junit_of(result.robot, cases(result), moment)


def junit_of(about: str, found: Sequence[Case], moment: datetime) -> str:
    """Return the text of a JUnit file with test cases.

    Parameters
    ----------
    about : str
        What was tested.
    found : sequence of Case
    moment : datetime
        Of the test.
    """
    failures = str(sum(bool(case.kind) for case in found))
    counts = {"tests": str(len(found)), "failures": failures, "errors": "0", "time": _NO_TIME}
    root = Element("testsuites", {"name": NAME, **counts})
    suite = SubElement(
        root,
        "testsuite",
        {
            "name": one_line(f"{NAME} {about}".strip()),
            "package": NAME,
            "id": "0",
            "hostname": "localhost",
            "timestamp": moment.strftime("%Y-%m-%dT%H:%M:%S"),
            "skipped": "0",
            **counts,
        },
    )
    SubElement(suite, "properties")
    for case in found:
        line = SubElement(
            suite, "testcase", {"classname": one_line(case.group), "name": one_line(case.name), "time": _NO_TIME}
        )
        if case.kind:
            failure = SubElement(line, "failure", {"type": case.kind, "message": one_line(case.why)})
            failure.text = one_line(case.why)
    SubElement(suite, "system-out")
    SubElement(suite, "system-err")
    indent(root)
    return tostring(root, encoding="unicode", xml_declaration=False, short_empty_elements=True).join(
        ('<?xml version="1.0" encoding="UTF-8"?>\n', "\n")
    )
