"""The demo mounts the load that `commission` asks for; the tests of commission read the same line."""

from sim.demo import LOAD_PROMPT


def test_the_line_that_asks_for_a_load_is_recognised():
    asked = LOAD_PROMPT.search("HANG LOAD gripper\n")
    assert asked is not None
    assert asked.group(1) == "gripper"
