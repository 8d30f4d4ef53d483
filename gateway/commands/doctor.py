"""Command `doctor`: check whether this computer can control an arm, and print the commands that fix problems."""

from __future__ import annotations

import errno
import os
import platform
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from ctypes.util import find_library
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import click

from gateway.commands.console import findings_table
from gateway.commands.pages import find_browser
from gateway.commands.shared_options import common, json_option, session_of, write_json
from gateway.result.finding import Finding

#: Oldest and newest tested versions of Python.
TRIED: Final = ((3, 11), (3, 13))
#: Device type of a CAN interface in Linux (linux/if_arp.h).
ARPHRD_CAN: Final = "280"
#: Bit rates recommended by CiA 301 for a bus of drives [bit/s].
BITRATES: Final = (125_000, 250_000, 500_000, 800_000, 1_000_000)
#: Least free space for a day of recordings [GB].
LEAST_GB: Final = 2.0
#: An earlier wall clock time means that the clock is not set [s since 1970]: 2025.
CLOCK_SET_S: Final = 1_735_689_600.0
#: Clock sources of Linux that are read without a system call.
FAST_CLOCKS: Final = frozenset({"tsc", "arch_sys_counter", "kvm-clock", "hyperv_clocksource_tsc_page"})
#: Shortest transmit queue that takes the frames of a SYNC while the bus is busy; a CAN interface has 10 by default.
LEAST_QUEUE: Final = 100
#: Library of the vendor's driver as python-can loads it, by interface.
LIBRARIES: Final = {"pcan": "pcanbasic", "kvaser": "canlib", "vector": "vxlapi64", "ixxat": "vcinpl"}
BRING_UP: Final = "sudo ip link set {name} txqueuelen 1000 up type can bitrate 1000000"


@click.command()
@json_option
@common
def doctor(json_out: str | None) -> None:
    """Check this computer: Python, real-time permission, CAN interfaces, clock, browser, disk; print remedies.

    Nothing is sent and nothing is changed.

    \b
    Example:
      servo-gateway doctor
    """
    checks = list(look(Path("/"), Path.cwd()))
    if json_out is not None:  # numpy is loaded for it
        from gateway.result.values import plain_values

        write_json(json_out, {"schema": 1, "checks": plain_values(checks)})
    session_of().show(findings_table(checks, "this computer"))


def look(root: Path, folder: Path) -> Iterator[Finding]:
    """Check this computer.

    Parameters
    ----------
    root : Path
        Root of the system files.
    folder : Path
        Folder for recordings.
    """
    yield _python()
    yield _system()
    yield from _real_time()
    yield from can_interfaces(root, kernel_has_can())
    yield from adapter_drivers(root)
    yield from _clock(root)
    yield _browser()
    yield _disk(folder)


def _python() -> Finding:
    now = sys.version_info[:2]
    what = f"{platform.python_version()} ({sys.executable})"
    if TRIED[0] <= now <= TRIED[1]:
        return Finding("ok", "Python", what)
    low, high = (".".join(map(str, each)) for each in TRIED)
    return Finding("warn", "Python", f"{what}: tested with {low} to {high}", f"python{low} -m venv .venv")


def _system() -> Finding:
    what = f"{platform.system()} {platform.release()}"
    if sys.platform == "linux":
        return Finding("ok", "system", what)
    return Finding(
        "warn", "system", f"{what}: offline commands only; arms are controlled on Linux", "use Linux to control an arm"
    )


def _real_time() -> Iterator[Finding]:
    from drives.realtime import available

    status = available()
    advice = 'sudo sh -c \'printf "%s - rtprio 40\\n%s - memlock unlimited\\n" $SUDO_USER $SUDO_USER >>'
    advice = f"{advice} /etc/security/limits.conf', then log in again"
    for name, is_permitted, missing in (
        (
            "real-time scheduler",
            status.fifo,
            "not permitted (RLIMIT_RTPRIO): the motion loop may be delayed under load",
        ),
        ("locked memory", status.locked, "not permitted (RLIMIT_MEMLOCK): the motion loop may wait for the disk"),
    ):
        yield Finding("ok", name, "permitted") if is_permitted else Finding("warn", name, missing, advice)


def kernel_has_can() -> bool:
    """Return whether the kernel opens a raw CAN socket."""
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except AttributeError:
        return False
    except OSError as error:
        return error.errno not in (errno.EAFNOSUPPORT, errno.EPROTONOSUPPORT)
    return True


def can_interfaces(root: Path, kernel: bool) -> Iterator[Finding]:
    """Return the CAN interfaces with driver, state and bit rate."""
    if not kernel:
        yield Finding(
            "warn",
            "CAN",
            "this kernel has no SocketCAN",
            "sudo modprobe can can_raw; without that module: use a kernel with CONFIG_CAN, or an adapter with its "
            "own driver (pcan, kvaser, slcan: see `[bus.X] interface`)",
        )
        return
    found = [each for each in sorted((root / "sys/class/net").glob("*")) if _text(each / "type") == ARPHRD_CAN]
    if not found:
        serial = sorted(each.name for each in (root / "dev").glob("ttyACM*"))
        slcan = f"; a serial adapter: sudo slcand -o -s8 /dev/{serial[0]} can0" if serial else ""
        yield Finding("warn", "CAN", "no CAN interface", f"connect an adapter and check `dmesg | tail`{slcan}")
    for each in found:
        yield _interface(each)


def _interface(place: Path) -> Finding:
    driver = (place / "device/driver").resolve().name if (place / "device/driver").exists() else "virtual"
    state, link = _text(place / "operstate"), _link(place.name)
    rate, controller = link.get("bittiming", {}).get("bitrate"), link.get("state", "")
    queue = _text(place / "tx_queue_len")
    shown = {"controller": controller, "txqueuelen": queue, "restart-ms": link.get("restart_ms")}
    facts = [f"{rate} bit/s"] if rate else []
    facts += [f"{name} {value}" for name, value in shown.items() if value not in (None, "")]
    said = ", ".join([f"driver {driver}, {state or 'state unknown'}", *facts])
    if driver == "virtual":
        return Finding("ok", place.name, f"{said}: virtual, no physical bus")
    bring_up = BRING_UP.format(name=place.name)
    if controller in ("BUS-OFF", "ERROR-PASSIVE", "ERROR-WARNING"):
        advice = f"check drive supply, wiring, termination and bit rate; sudo ip link set {place.name} down; {bring_up}"
        return Finding("warn", place.name, said, advice)
    if state == "down":
        return Finding("warn", place.name, said, bring_up)
    if rate and rate not in BITRATES:
        return Finding(
            "warn", place.name, f"{said}: not a bit rate of CiA 301", f"sudo ip link set {place.name} down; {bring_up}"
        )
    if queue and int(queue) < LEAST_QUEUE:
        advice = f"sudo ip link set {place.name} txqueuelen 1000"
        return Finding("warn", place.name, f"{said}: shorter than the frames of one SYNC may need", advice)
    return Finding("ok", place.name, said)


def _link(name: str) -> dict[str, Any]:
    """Return what `ip` reports of a CAN controller: state, bittiming, restart_ms; empty if unknown."""
    import json

    try:
        words = ["ip", "-details", "-json", "link", "show", name]
        done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=5)
        return dict(json.loads(done.stdout or "[]")[0]["linkinfo"]["info_data"])
    except (OSError, ValueError, LookupError, TypeError, subprocess.TimeoutExpired):
        return {}


def adapter_drivers(root: Path) -> Iterator[Finding]:
    """Return for each interface beside SocketCAN whether its driver library or package is installed; none is opened."""
    from drives.bus import NEEDS

    serial = [f"/dev/{each.name}" for kind in ("ttyACM*", "ttyUSB*") for each in sorted((root / "dev").glob(kind))]
    packages = {"slcan": find_spec("serial") and f"package pyserial, serial ports: {', '.join(serial) or 'none'}"}
    for interface, what in (packages | {each: find_library(name) for each, name in LIBRARIES.items()}).items():
        if what:
            yield Finding("ok", interface, what)
        else:
            yield Finding("info", interface, "driver not installed", f"only for such an adapter: {NEEDS[interface]}")


def _clock(root: Path) -> Iterator[Finding]:
    source = _text(root / "sys/devices/system/clocksource/clocksource0/current_clocksource")
    if source and source not in FAST_CLOCKS:
        yield Finding("warn", "clock", f"clock source {source} is slow to read", "boot with clocksource=tsc")
    else:
        resolution_s = time.get_clock_info("monotonic").resolution
        yield Finding("ok", "clock", f"{source or 'monotonic'}, resolution {1e9 * resolution_s:.0f} ns")
    if time.time() < CLOCK_SET_S:
        yield Finding("warn", "time of day", "is not set: files get a wrong date", "sudo timedatectl set-ntp true")


def _browser() -> Finding:
    found = find_browser()
    if found is None:
        return Finding(
            "warn",
            "browser",
            "no browser that can print PDF",
            "sudo apt-get install chromium; without it reports are HTML only",
        )
    return Finding("ok", "browser", found)


def _disk(folder: Path) -> Finding:
    free_gb = shutil.disk_usage(folder).free / 1e9
    what = f"{free_gb:.1f} GB free in {folder}"
    if not os.access(folder, os.W_OK):
        return Finding("warn", "disk", f"{folder} is not writable", "change to a folder with write permission")
    if free_gb < LEAST_GB:
        return Finding("warn", "disk", what, "free disk space, or record to another disk: -o /other/disk/run.h5")
    return Finding("ok", "disk", what)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8").strip()
    except OSError:
        return ""
