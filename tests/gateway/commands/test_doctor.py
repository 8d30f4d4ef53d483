"""doctor: every state of a computer gives its line, with what to type where something is missing."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from gateway.cli import main
from gateway.commands import doctor
from gateway.commands.doctor import can_interfaces, look


def interface(root, name, state, driver=None, kind="280"):
    """A network device of a system that is laid out under a folder."""
    place = root / "sys/class/net" / name
    place.mkdir(parents=True)
    (place / "type").write_text(f"{kind}\n")
    (place / "operstate").write_text(f"{state}\n")
    if driver is not None:
        (root / "drivers" / driver).mkdir(parents=True, exist_ok=True)
        (place / "device").mkdir()
        (place / "device/driver").symlink_to(root / "drivers" / driver)


@pytest.fixture
def rates(monkeypatch):
    """What the program `ip` reports of each controller."""
    known: dict[str, dict[str, object]] = {}
    monkeypatch.setattr(doctor, "_link", lambda name: known.get(name, {}))
    return known


def test_interfaces_are_named_with_driver_state_and_bit_rate(tmp_path, rates):
    rates |= {f"can{number}": {"bittiming": {"bitrate": rate}} for number, rate in ((0, 1_000_000), (2, 333_333))}
    rates["can3"] = {"state": "BUS-OFF", "restart_ms": 0, "bittiming": {"bitrate": 500_000}}
    interface(tmp_path, "can0", "up", "peak_usb")
    interface(tmp_path, "can1", "down", "gs_usb")
    interface(tmp_path, "can2", "up", "gs_usb")
    interface(tmp_path, "can3", "up", "gs_usb")
    rates["can5"] = {"state": "ERROR-PASSIVE", "bittiming": {"bitrate": 500_000}}
    interface(tmp_path, "can4", "up", "gs_usb")
    interface(tmp_path, "can5", "up", "gs_usb")
    (tmp_path / "sys/class/net/can4/tx_queue_len").write_text("10\n")
    interface(tmp_path, "vcan0", "unknown")
    interface(tmp_path, "eth0", "up", "e1000", kind="1")
    found = {each.where: each for each in can_interfaces(tmp_path, kernel=True)}
    assert set(found) == {"can0", "can1", "can2", "can3", "can4", "can5", "vcan0"}
    assert (found["can0"].severity, found["can0"].what) == ("ok", "driver peak_usb, up, 1000000 bit/s")
    assert found["can1"].severity == "warn"
    assert found["can1"].advice == "sudo ip link set can1 txqueuelen 1000 up type can bitrate 1000000"
    assert "not a bit rate of CiA 301" in found["can2"].what
    assert (found["can3"].severity, found["can4"].severity) == ("warn", "warn")
    assert "500000 bit/s, controller BUS-OFF, restart-ms 0" in found["can3"].what
    assert "txqueuelen" in found["can4"].advice
    assert found["can5"].severity == "warn"
    assert "termination" in found["can5"].advice
    assert "virtual, no physical bus" in found["vcan0"].what


def test_a_kernel_without_can_is_not_answered_by_ip_link(tmp_path):
    (line,) = can_interfaces(tmp_path, kernel=False)
    assert line.severity == "warn"
    assert "modprobe can" in line.advice
    assert "ip link" not in line.advice


def test_adapters_without_socketcan_are_named_with_what_is_missing(tmp_path, monkeypatch):
    monkeypatch.setattr(doctor, "find_library", lambda name: "libcanlib.so.1" if name == "canlib" else None)
    found = {each.where: each for each in doctor.adapter_drivers(tmp_path)}
    assert set(found) == {"slcan", "pcan", "kvaser", "vector", "ixxat"}
    assert (found["kvaser"].severity, found["kvaser"].what) == ("ok", "libcanlib.so.1")
    assert (found["pcan"].severity, "PCAN-Basic" in found["pcan"].advice) == ("info", True)


def test_no_interface_asks_for_an_adapter_and_names_a_serial_one(tmp_path):
    (line,) = can_interfaces(tmp_path, kernel=True)
    assert "connect an adapter" in line.advice
    (tmp_path / "dev").mkdir()
    (tmp_path / "dev/ttyACM0").touch()
    (line,) = can_interfaces(tmp_path, kernel=True)
    assert "slcand -o -s8 /dev/ttyACM0 can0" in line.advice


def test_what_is_missing_comes_with_what_to_type(tmp_path, monkeypatch):
    monkeypatch.setattr(doctor, "find_browser", lambda: None)
    monkeypatch.setattr(doctor, "kernel_has_can", lambda: False)
    monkeypatch.setattr("drives.realtime._capable", lambda number: False)
    monkeypatch.setattr("drives.realtime._limit", lambda name: 0.0)
    monkeypatch.setattr("time.time", lambda: 1000.0)
    clock = tmp_path / "sys/devices/system/clocksource/clocksource0"
    clock.mkdir(parents=True)
    (clock / "current_clocksource").write_text("hpet\n")
    found = {each.where: each for each in look(tmp_path, tmp_path)}
    missing = {"real-time scheduler", "locked memory", "CAN", "clock", "time of day", "browser"}
    assert {where for where, each in found.items() if each.severity == "warn"} == missing
    assert all(found[where].advice for where in missing)
    assert "rtprio 40" in found["real-time scheduler"].advice


def test_the_command_shows_and_writes_every_line(tmp_path):
    out = tmp_path / "d.json"
    done = CliRunner().invoke(main, ["doctor", "--json", str(out)])
    assert done.exit_code == 0, done.output
    checks = json.loads(out.read_text())["checks"]
    assert {"Python", "system", "real-time scheduler", "locked memory", "browser", "disk"} <= {
        c["where"] for c in checks
    }
    assert all(each["advice"] for each in checks if each["severity"] != "ok")
    assert all(each["where"].split()[0] in done.stdout for each in checks)
