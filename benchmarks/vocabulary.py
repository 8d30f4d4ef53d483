"""Words of the project's old private vocabulary, what replaces them, and where they are right."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

#: Parts of an identifier (`doubt` of `mass_doubt_kg`) that are of the old vocabulary, and what replaces them.
PARTS: Final[Mapping[str, str]] = {
    "told tell tells": "reported, detected, estimated",
    "way ways": "path, trajectory, segment, method",
    "doubt doubts sure": "uncertainty, confidence",
    "late alike anew hardly": "delayed; equal, correlated; again; barely",
    "somebody nobody anybody whoever": "the actor: operator, drive, command",
    "stands lies sits standing lying": "is, is at, at rest",
    "rub rubs wander wanders sag sags": "friction, drift, drop",
    "hang hangs hung hanging": "mounted, attached",
    "silent silence": "not responding, stopped",
    "story stories shelf keeper salvage": "frame decoder, spool, recorder, recovery",
    "felt lesson lessons passage learner": "force estimate, taught path, prepared trajectory, learning control",
    "foretold foretell outlook": "predicted, expected information",
    "advice": "recommendation, remedy",
    "saying sayings sentence sentences": "text, message",
    "unlike": "heterogeneous",
    "house room rooms floors": "package, layer",
    "aside gross": "rejected, outlier",
    "ordinary": "nuisance parameters",
    "hear hears heard believe believed knows": "receive, detect, assume, store",
}
#: Whole identifiers and file names that say nothing or have a private meaning.
WHOLE: Final[Mapping[str, str]] = {
    "given whole": "inputs; full model",
    "analyse": "session, pipeline",
}
FILES: Final[Mapping[str, str]] = {
    "words sentences complete given analyse story ring": "what the file holds",
}
#: Identifiers that are keys of the documented files and JSON.
KEYS: Final = frozenset(
    {"advice", "cannot_tell", "gross", "late", "lesson", "set_aside", "silent", "silent_days", "tells_apart", "ways"}
)

#: Phrases of texts: docstrings, comments, messages, pages.
PHRASES: Final[Mapping[str, str]] = {
    r"told|tells|(?<!cannot )tell(?! apart)|telling": "report, detect, determine",
    r"(?<!by )(?<!same )(?<!this )(?<!that )(?<!other )(?<!another )(?<!either )(?<!both )(?<!one )(?<!half )"
    r"(?<!one-)(?<!two-)(?<!only )(?<!which )(?<!any )(?<!no )ways?(?! of \w+ing)": "path, trajectory, segment, method",
    r"set points?": "setpoint",
    r"doubts?|how sure|(?<!make )(?<!makes )sure|surely": "uncertainty, confidence",
    r"(?<!too )late|alike|anew|hardly": "delayed; equal; again; barely",
    r"somebody|nobody|anybody|everybody|whoever": "name the actor",
    r"(?<!there )(?<!There )is no (?!longer|more than|greater|larger|less)\w+": "is not ...",
    r"stands?(?! for)|stood|lies|lie|sits?": "is, is at, is stored in",
    r"rub|rubs|rubbed|rubbing|wander|wanders|wandering|sags?|sagging|holds? up|held up": "friction, drift, drop, stall",
    r"hang|hangs|hung|hanging": "mounted, attached",
    r"bare arms?": "unloaded arm",
    r"frozen heartbeats?|silent(?!-days)|silence": "heartbeat stopped, not responding",
    r"by the clock": "in real time",
    r"story|stories|shelf|keeper|salvaged?": "frame decoder, spool, recorder, recovery",
    r"felt|lessons?|passages?|learner": "force estimate, taught path, prepared trajectory",
    r"foretold|foretells?|outlook|advice|advises?": "predicted, expected information, recommendation",
    r"sayings?": "event text",
    r"of one kind": "homogeneous",
    r"house|(?<!in the )rooms?(?! temperature| for)|(?<!noise )floors(?! and)": "package, layer",
    r"aside|gross(?! error)": "rejected, outlier",
    r"(?<!extra)ordinary|what every arm has": "nuisance parameters",
    r"hears?|heard|believes?|believed|knows": "receive, detect, assume, store",
    r"comes? to from|worked out|goes wrong|brought elsewhere|hardly|as it were": "plain verb",
}
#: (path, what was found there): words that are right where they are used, with the reason.
EXCEPTIONS: Final[Mapping[tuple[str, str], str]] = {
    ("benchmarks/vocabulary.py", "*"): "the list of words itself",
    ("tests/benchmarks/test_language.py", "*"): "examples of the words",
    ("gateway/commands/guided.py", "hang"): "line on standard output that scripts wait for",
    ("sim/demo.py", "hang"): "the same line, waited for",
    ("tests/sim/test_demo.py", "hang"): "the same line, waited for",
    ("tests/system/conftest.py", "hang"): "the same line, waited for",
    ("CONTRIBUTING.md", "*"): "shows the words and their replacements",
    ("benchmarks/language.py", "sentence"): "a sentence of a text is what is counted",
    ("benchmarks/language.py", "sentences"): "a sentence of a text is what is counted",
    ("benchmarks/language.py", "whole"): "name of the table of whole identifiers",
    ("benchmarks/chaos/stated.py", "silent"): "key of a rule in the table of reactions",
    ("tests/support/pages/result.py", "late"): "key of the documented JSON: answers of a bus after their SYNC",
}
#: Words that codespell takes for slips: names, identifiers and terms of the field, other languages.
SPELLED: Final = (
    "cantact", "fro", "informations", "ist", "nd", "notin", "ot", "ser", "sie", "som", "statics", "te", "tothe"
)  # fmt: skip
#: Slips that tests type on purpose.
SPELLED_WRONG: Final = ("exprot", "fo", "nwe", "wieght")
#: Files that are not read for spelling: data and pictures.
NOT_SPELLED: Final = ("*.stl", "*.h5", "*.png", "*.csv", "*.eds", "*.dcf", "*.json", "*.svg")
