"""Completion: each shell gets a script, and what the script asks for is answered."""

import os
import shutil
import subprocess
import sys

import pytest
from click.testing import CliRunner

from gateway.cli import main

PROGRAM = "servo-gateway"
VARIABLE = "_SERVO_GATEWAY_COMPLETE"


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_script_names_the_program_and_how_it_is_asked(shell):
    done = CliRunner().invoke(main, ["completion", shell], prog_name=PROGRAM)
    assert done.exit_code == 0
    assert PROGRAM in done.stdout
    assert VARIABLE in done.stdout
    if shutil.which(shell):
        assert subprocess.run([shell, "-n"], input=done.stdout, text=True, check=False).returncode == 0


@pytest.mark.parametrize(
    ("words", "number", "offered"),
    [
        ("servo-gateway est", 1, "estimate"),
        ("servo-gateway estimate --me", 2, "--method"),
        ("servo-gateway export a.json --format ya", 4, "yaskawa"),
        ("servo-gateway profiles sh", 2, "show"),
    ],
)
def test_what_can_follow_is_offered(words, number, offered):
    asked = os.environ | {VARIABLE: "bash_complete", "COMP_WORDS": words, "COMP_CWORD": str(number)}
    code = "import sys; sys.argv[0] = 'servo-gateway'; from gateway.cli import main; main()"
    done = subprocess.run([sys.executable, "-c", code], env=asked, capture_output=True, text=True, check=False)
    assert f"plain,{offered}" in done.stdout.splitlines(), done.stderr


def test_a_shell_that_is_none_is_a_usage_error():
    done = CliRunner().invoke(main, ["completion", "cmd"])
    assert done.exit_code == 2
    assert "bash" in done.stderr
