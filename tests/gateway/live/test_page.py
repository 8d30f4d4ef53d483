"""The process of the page: on this computer alone, on a port that is free, and never longer than the command."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator

import pytest

from gateway.errors import ConfigError
from gateway.live.guard import HOST
from gateway.live.page import PORT, LivePage
from tests.support.processes import gone, wait_until

PATIENCE_S = 30.0
#: A command that dies without a word: its page has a process of its own, whose number it prints.
DIES = """
import os
from gateway.live.page import LivePage
page = LivePage("dies")
print(page.process.pid, page.address, flush=True)
input()
os._exit(1)
"""


@pytest.fixture
def page() -> Iterator[LivePage]:
    with LivePage("a test") as page:
        yield page


def answer(address: str) -> tuple[int, str]:
    with contextlib.closing(urllib.request.urlopen(address, timeout=PATIENCE_S)) as response:
        return response.status, response.read().decode()


def test_the_printed_address_is_answered_and_the_end_ends_the_process():
    with LivePage("a test") as page:
        status, text = answer(page.address)
        assert status == 200
        assert "<canvas" in text
        with pytest.raises(urllib.error.HTTPError, match="403"):
            answer(page.address.partition("?")[0])
    assert page.process.returncode == 0


@pytest.mark.slow
def test_two_pages_have_two_ports(page):
    with LivePage("another") as other:
        assert other.address != page.address
        assert answer(other.address)[0] == 200


def test_a_port_that_is_taken_gives_one_line():
    with socket.socket() as taken:
        taken.bind((HOST, 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(ConfigError, match=rf"--port {port}: Address already in use; choose another one"):
            LivePage("a test", port)


def test_without_a_wish_the_next_free_port_is_taken():
    with contextlib.ExitStack() as stack:
        for number in range(PORT, PORT + 2):
            listener = stack.enter_context(socket.socket())
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            with contextlib.suppress(OSError):  # something else may be there: taken as well
                listener.bind((HOST, number))
                listener.listen()
        page = stack.enter_context(LivePage("a test"))
        assert int(page.address.split(":")[2].split("/")[0]) > PORT + 1


def test_no_other_computer_on_the_network_reaches_it(page):
    """127.0.0.2 is the same computer by another of its addresses: no server listens there."""
    port = int(page.address.split(":")[2].split("/")[0])
    with socket.socket() as elsewhere, pytest.raises(ConnectionRefusedError):
        elsewhere.connect(("127.0.0.2", port))


def test_the_page_ends_when_its_command_is_gone():
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    program = subprocess.Popen(
        [sys.executable, "-c", DIES], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
    )
    assert program.stdout is not None
    number, address = program.stdout.readline().split()
    assert answer(address)[0] == 200
    program.communicate("\n")
    assert program.returncode == 1
    wait_until(lambda: gone(int(number)))
