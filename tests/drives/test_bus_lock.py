"""One bus has one master: the lock between the commands of all users of a computer."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import suppress

import pytest

from drives import bus_lock
from drives.bus_lock import bus_locked
from drives.bus_spec import BusSpec
from drives.errors import BusError

CAN = BusSpec("socketcan", "can-of-a-test")
HOLDER = """
import sys
from pathlib import Path
from drives import bus_lock
from drives.bus_spec import BusSpec
bus_lock.FOLDERS = (Path(sys.argv[1]),)
with bus_lock.bus_locked(BusSpec("socketcan", "can-of-a-test"), "servo-gateway move"):
    print("locked", flush=True)
    sys.stdin.readline()
"""


@pytest.fixture(autouse=True)
def folders(tmp_path, monkeypatch):
    """One shared folder that there is, and one that is missing."""
    shared = tmp_path / "shared"
    shared.mkdir()
    monkeypatch.setattr(bus_lock, "FOLDERS", (tmp_path / "missing", shared))
    return shared


def refused(spec: BusSpec) -> str:
    with pytest.raises(BusError) as error, bus_locked(spec, "servo-gateway check"):
        pass
    assert error.value.exit_code == 4
    return str(error.value)


@pytest.mark.parametrize("spec", [CAN, BusSpec("virtual", "a-test")])
def test_a_second_command_is_refused_until_the_first_one_has_ended(spec):
    with suppress(ZeroDivisionError), bus_locked(spec, "servo-gateway commission"):
        assert f"process {os.getpid()} (servo-gateway commission)" in refused(spec)
        raise ZeroDivisionError
    with bus_locked(spec, "servo-gateway check"):
        pass


def test_a_process_that_is_killed_leaves_the_bus(folders):
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(folders)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "locked\n"
        assert f"process {process.pid} (servo-gateway move)" in refused(CAN)
        process.kill()
    with bus_locked(CAN, "servo-gateway check"):
        pass


def test_every_user_can_open_the_file(folders):
    before = os.umask(0o077)
    try:
        with bus_locked(CAN, "servo-gateway check"):
            (file,) = folders.iterdir()
            assert file.stat().st_mode & 0o777 == 0o666
    finally:
        os.umask(before)


def test_a_bus_that_cannot_be_locked_is_not_used(folders):
    folders.rmdir()
    assert "cannot be locked" in refused(CAN)


@pytest.mark.parametrize(
    ("first", "second", "same"),
    [
        ("udp_multicast:239.74.163.2", "udp_multicast:239.74.163.2,port=43113,hop_limit=0", True),
        ("udp_multicast:239.74.163.2", "udp_multicast:239.74.163.2,port=43114", False),
        ("socketcan:can0", "socketcan:can0,bitrate=500000", True),
        ("gs_usb:can0,index=0", "gs_usb:can0,index=1", False),
        ("slcan:/dev/null", "slcan:/dev/../dev/null", True),
    ],
)
def test_what_is_one_bus(first, second, same):
    with bus_locked(BusSpec.parse(first), "servo-gateway check"):
        if same:
            refused(BusSpec.parse(second))
        else:
            with bus_locked(BusSpec.parse(second), "servo-gateway check"):
                pass
