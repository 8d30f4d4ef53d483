"""What the program says about the state of an arm comes from the gate, which has just read every drive."""

from __future__ import annotations

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
#: What a sentence about the state of an arm would say.
STATE = re.compile(
    r"in (?:its|their) brakes?|brakes? (?:are |is )?(?:engaged|closed)|(?:as|now|was|were) disabled"
    r"|(?:was|were) stopped|nothing (?:was written|has moved)|(?:is|are|was|were) restored"
    r"|arms? (?:is|are) safe|no longer (?:moves|powered)"
)
#: Where the sources say so, file and part of the sentence.
SAID = {
    # from the gate; the phases are entered by what it has read
    ("drives/gate.py", "every drive was read as disabled at"),
    ("drives/gate.py", "sent an emergency while it was disabled"),
    ("gateway/motion/state.py", "in its brakes"),
    ("gateway/errors.py", "the message states whether all its drives were read as disabled"),
    # read by the sequence that disables; what failed was the release after that
    ("drives/group.py", "every drive was read as disabled; then: "),
    # of what this command itself has written, refused or stopped
    ("drives/access.py", " was restored, but "),
    ("gateway/commands/bus.py", "nothing has moved: correct the failed items first"),
    ("gateway/jobs/calibrate.py", "; nothing has moved"),
    ("gateway/commands/cell.py", "nothing was written: the line numbers refer to the draft"),
    ("gateway/commands/config.py", "nothing was written to the drives of"),
    ("gateway/jobs/configure.py", "nothing was written to the drives of"),
    ("gateway/jobs/frame.py", "By this command nothing has moved since the question"),
    ("gateway/check/moves.py", "small moves were stopped: "),
    ("gateway/follow/path_run.py", "the arm was stopped"),
    ("gateway/pair/controller.py", "an epoch was incomplete or the arms were stopped"),
    # of a brake that was just measured
    ("gateway/check/brakes.py", " rad in its brake "),
    ("gateway/check/brakes.py", "when all axes were disabled"),
    ("gateway/motion/power.py", " rad in its brake after its drive was disabled"),
}


def test_texts_on_the_state_of_an_arm_come_from_the_gate():
    found = set()
    for path in (*ROOT.glob("drives/**/*.py"), *ROOT.glob("gateway/**/*.py")):
        name, nodes = path.relative_to(ROOT).as_posix(), list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
        documents = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
        texts = [node.value for node in nodes if isinstance(node, ast.Constant) and id(node) not in documents]
        for text in texts:
            if isinstance(text, str) and STATE.search(text):
                found |= {(file, part) for file, part in SAID if file == name and part in text} or {(name, text)}
    assert found == SAID
