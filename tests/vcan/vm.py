"""Run a command where a SocketCAN interface `vcan0` is up: here if the kernel can, else in a small virtual machine.

python tests/vcan/vm.py [--install] [--where native|vm] [-- COMMAND ...]

Without COMMAND the tests marked `vcan` run, except those that move by the clock. Order of preference: a `vcan0` that
exists or can be made; else a qemu virtual machine; else the run is skipped with the reason. The virtual machine is a
software emulation without network, with the kernel of the distribution and the folders of this machine shared into it.
Where `SERVO_GATEWAY_REQUIRE_VCAN=1` is set a skip is a failure, and missing packages are installed as with `--install`.
Kernel and unpacked modules are kept in `.cache/vcan`.

Only the standard library is used, except to run the tests themselves.
"""

from __future__ import annotations

import argparse
import compileall
import os
import re
import shlex
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import BinaryIO

ROOT = Path(__file__).resolve().parents[2]
CACHE = ROOT / ".cache" / "vcan"
PACKAGES = ("qemu-system-x86", "busybox-static", "cpio", "kmod", "iproute2", "can-utils")
TOOLS = ("qemu-system-x86_64", "busybox", "cpio", "modprobe", "depmod", "ip")
MODULES = ("virtio_pci", "9pnet_virtio", "9p", "can-raw", "can-bcm", "vcan", "sch_netem", "sch_tbf")
GUEST_STARTS = "guest: command starts"
GUEST_ENDS = "guest: command ended"
KERNEL_META = "linux-image-amd64"
SYSTEM_PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
TIME_LIMIT_S = 2700.0
#: Times that a download is tried, and the pause between them [s].
TRIES, PAUSE_S = 4, 15.0
#: The emulator ends numpy's AVX2 sort with a segmentation fault: it does without.
EMULATED = {"NPY_DISABLE_CPU_FEATURES": "X86_V3"}
PASSED_ON = ("SERVO_GATEWAY_DATA", "HYPOTHESIS_PROFILE")


class VcanMissing(Exception):  # noqa: N818 - reads as what happened
    """No way to a vcan0 on this machine; the text is the reason."""


def main(argv: Sequence[str]) -> int:
    """Run the command; the exit status is the command's own, 0 with a printed reason for a permitted skip."""
    parser = argparse.ArgumentParser(prog="vm.py", description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--install", action="store_true", help="install the packages that are missing (as root)")
    parser.add_argument("--where", choices=("native", "vm"), help="do not choose, use this one")
    parser.add_argument("command", nargs="*", help="what to run; after --")
    arguments = parser.parse_args(argv)
    required = os.environ.get("SERVO_GATEWAY_REQUIRE_VCAN") == "1"
    pytest = f"{sys.executable} -m pytest -p no:cacheprovider tests/vcan -m"
    command = arguments.command or [*shlex.split(pytest), "vcan and not clock"]
    try:
        if arguments.where != "vm" and native_vcan():
            return run_native(command)
        if arguments.where == "native":
            raise VcanMissing("this kernel has no vcan, or the right to make vcan0 is missing")
        return run_in_vm(command, install=arguments.install or required)
    except VcanMissing as missing:
        print(f"vcan tests {'FAILED' if required else 'skipped'}: {missing}", flush=True)
        return 1 if required else 0


# --------------------------------------------------------------------------------------------------------- native


def native_vcan() -> bool:
    """Whether `vcan0` is up on this machine, made now if it can be."""
    environment = os.environ | {"PATH": f"{os.environ.get('PATH', '')}:{SYSTEM_PATH}"}

    def quiet(*words: str) -> bool:
        try:
            return subprocess.run(words, env=environment, capture_output=True, timeout=20, check=False).returncode == 0
        except (OSError, subprocess.TimeoutExpired):
            return False

    if not quiet("ip", "link", "show", "vcan0"):
        quiet("modprobe", "vcan")
        if not quiet("ip", "link", "add", "dev", "vcan0", "type", "vcan"):
            return False
    quiet("ip", "link", "set", "vcan0", "txqueuelen", "1000", "up")
    return quiet("ip", "link", "show", "up", "dev", "vcan0")


def run_native(command: Sequence[str]) -> int:
    """Run the command on the machine's own vcan0."""
    print("vcan0: native", flush=True)
    return subprocess.run(list(command), cwd=ROOT, env=os.environ | {"SERVO_GATEWAY_REQUIRE_VCAN": "1"}).returncode


# ------------------------------------------------------------------------------------------------ virtual machine


def run_in_vm(command: Sequence[str], install: bool) -> int:
    """Boot the virtual machine, run the command in it, and return the command's exit status."""
    provide_tools(install)
    for package in ("benchmarks", "drives", "gateway", "sim", "tests"):  # emulated, each start would compile for itself
        compileall.compile_dir(ROOT / package, quiet=1)
    unpacked, version = provide_kernel()
    work = CACHE / f"run-{os.getpid()}"
    work.mkdir(parents=True)
    try:
        ramdisk = build_ramdisk(unpacked, version, work)
        return boot(unpacked / "boot" / f"vmlinuz-{version}", ramdisk, command, work)
    finally:
        shutil.rmtree(work, ignore_errors=True)


def provide_tools(install: bool) -> None:
    """Look for qemu and its helpers, install them when that is asked for."""
    missing = [tool for tool in TOOLS if shutil.which(tool, path=SYSTEM_PATH) is None]
    if not missing:
        return
    if not install or os.geteuid() != 0 or shutil.which("apt-get") is None:
        raise VcanMissing(
            f"the kernel has no vcan and {', '.join(missing)} is missing for the virtual machine; "
            f"install {' '.join(PACKAGES)}, or run this as root with --install"
        )
    words = ["apt-get", "install", "-y", "-qq", "--no-install-recommends", *PACKAGES]

    def install_all() -> None:
        run(["apt-get", "update", "-qq"], "package lists cannot be read")
        run(words, "packages for the virtual machine cannot be installed", {"DEBIAN_FRONTEND": "noninteractive"})

    again(install_all)


def again(download: Callable[[], None]) -> None:
    """Do something that the network may spoil, and do it again if it did."""
    for attempt in range(TRIES):
        try:
            return download()
        except VcanMissing as missing:
            if attempt == TRIES - 1:
                raise
            print(f"{missing}; once more in {PAUSE_S:.0f} s", flush=True)
            time.sleep(PAUSE_S)
    return None


def provide_kernel() -> tuple[Path, str]:
    """Folder of the unpacked kernel package and its version; fetched once, never installed as the machine's own."""
    unpacked = CACHE / "unpacked"
    versions = sorted(path.name.removeprefix("vmlinuz-") for path in (unpacked / "boot").glob("vmlinuz-*"))
    if versions and (unpacked / ".complete").exists():
        return unpacked, versions[-1]
    if shutil.which("apt-cache") is None:
        raise VcanMissing("no kernel package can be fetched here (apt-cache is missing)")
    shutil.rmtree(CACHE, ignore_errors=True)
    CACHE.mkdir(parents=True)
    names: list[str] = []

    def fetch() -> None:
        names[:] = re.findall(r"linux-image-\d\S*", kernel_names())
        if not names:
            raise VcanMissing(f"{KERNEL_META} names no kernel package")
        run(["apt-get", "download", "-qq", names[0]], f"{names[0]} cannot be fetched", folder=CACHE)

    again(fetch)
    package = next(CACHE.glob("linux-image-*.deb"))
    run(["dpkg", "-x", str(package), str(unpacked)], f"{package.name} cannot be unpacked")
    package.unlink()
    version = names[0].removeprefix("linux-image-")
    run(["depmod", "-b", str(unpacked), version], "module list cannot be made")
    (unpacked / ".complete").touch()
    return unpacked, version


def kernel_names() -> str:
    """What the distribution's kernel package depends on; its lists are read again where it is not known."""
    try:
        found = run(["apt-cache", "depends", KERNEL_META], "the kernel package is unknown")
    except VcanMissing:
        found = ""
    if "linux-image-" in found.replace(KERNEL_META, ""):
        return found
    run(["apt-get", "update", "-qq"], "package lists cannot be read")
    return run(["apt-cache", "depends", KERNEL_META], "the kernel package is unknown")


def build_ramdisk(unpacked: Path, version: str, work: Path) -> Path:
    """Initial ramdisk: a static busybox, the modules in loading order, and the init script."""
    root = work / "ramdisk"
    for folder in ("bin", "modules", "proc", "sys", "dev", "mnt"):
        (root / folder).mkdir(parents=True)
    busybox = shutil.which("busybox", path=SYSTEM_PATH)
    if busybox is None:
        raise VcanMissing("busybox is missing")
    shutil.copy(busybox, root / "bin" / "busybox")
    names = []
    for path in modules_in_order(unpacked, version):
        names.append(f"{len(names):02d}-{path.name}")
        shutil.copy(path, root / "modules" / names[-1])
    init = root / "init"
    init.write_text(INIT)
    init.chmod(0o755)
    ramdisk = work / "ramdisk.gz"
    listing = "\n".join(str(path.relative_to(root)) for path in [root, *sorted(root.rglob("*"))])
    with ramdisk.open("wb") as out:
        archive = subprocess.run(
            ["cpio", "-o", "-H", "newc", "--quiet"], cwd=root, input=listing.encode(), capture_output=True, check=True
        )
        subprocess.run(["gzip", "-1"], input=archive.stdout, stdout=out, check=True)
    return ramdisk


def modules_in_order(unpacked: Path, version: str) -> list[Path]:
    """Module files in the order in which `insmod` needs them."""
    ordered: list[Path] = []
    for module in MODULES:
        words = ["modprobe", "-d", str(unpacked), "-S", version, "--show-depends", module]
        for line in run(words, f"module {module} is not in the kernel package").splitlines():
            if line.startswith("insmod "):
                path = Path(line.split()[1])
                if path not in ordered:
                    ordered.append(path)
    return ordered


def boot(kernel: Path, ramdisk: Path, command: Sequence[str], work: Path) -> int:
    """Start qemu, show its console, and return the status that the guest left in a file."""
    status = work / "status"
    guest = work / "guest.sh"
    kept = {name: os.environ[name] for name in PASSED_ON if name in os.environ}
    kept |= EMULATED
    exports = "".join(f"export {name}={shlex.quote(value)}\n" for name, value in kept.items())
    text = GUEST.format(
        root=shlex.quote(str(ROOT)),
        exports=exports,
        command=shlex.join(command),
        status=shlex.quote(str(status)),
        starts=GUEST_STARTS,
        ends=GUEST_ENDS,
    )
    guest.write_text(text)
    append = f"console=ttyS0 quiet panic=-1 guest={guest}"
    words = [shutil.which("qemu-system-x86_64", path=SYSTEM_PATH) or "qemu-system-x86_64"]
    words += ["-accel", "tcg,thread=multi", "-cpu", "max", "-m", "3G", "-smp", "2", "-no-reboot", "-net", "none"]
    words += ["-display", "none", "-vga", "none", "-monitor", "none", "-serial", "stdio"]
    words += ["-kernel", str(kernel), "-initrd", str(ramdisk), "-append", append]
    words += ["-virtfs", "local,path=/,mount_tag=host,security_model=none,multidevs=remap"]
    print("vcan0: in a virtual machine (qemu, software emulation)", flush=True)
    started_s = time.monotonic()
    limit_s = float(os.environ.get("SERVO_GATEWAY_VM_LIMIT_S", TIME_LIMIT_S))
    console = work / "console.log"
    machine = subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    watchdog = threading.Timer(limit_s, machine.kill)
    watchdog.start()
    with console.open("wb") as log:
        show_command_output(machine.stdout or (), log)
    machine.wait()
    watchdog.cancel()
    print(f"virtual machine: {time.monotonic() - started_s:.0f} s", flush=True)
    try:
        return int(status.read_text())
    except (OSError, ValueError):
        tail = console.read_text(errors="replace").splitlines()[-15:]
        print("the virtual machine left no exit status; the end of its console:", *tail, sep="\n", flush=True)
        return 1


def show_command_output(lines: Iterable[bytes], log: BinaryIO) -> None:
    """Pass on what the command prints; the boot messages around it go to the log alone."""
    shown = False
    for line in lines:
        log.write(line)
        log.flush()
        if GUEST_ENDS.encode() in line:
            shown = False
        if shown:
            sys.stdout.buffer.write(line.replace(b"\r\n", b"\n"))
            sys.stdout.flush()
        if GUEST_STARTS.encode() in line:
            shown = True


def run(words: list[str], complaint: str, environment: dict[str, str] | None = None, folder: Path = ROOT) -> str:
    """Output of a helper program; a failure becomes `VcanMissing` with the complaint."""
    path = {"PATH": f"{SYSTEM_PATH}:{os.environ.get('PATH', '')}", "LC_ALL": "C"}
    try:
        done = subprocess.run(
            words, cwd=folder, env=os.environ | path | (environment or {}), capture_output=True, text=True, timeout=300
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise VcanMissing(f"{complaint}: {error}") from error
    if done.returncode != 0:
        raise VcanMissing(f"{complaint}: {done.stderr.strip().splitlines()[-1:] or done.returncode}")
    return done.stdout


INIT = """#!/bin/busybox sh
/bin/busybox mount -t proc proc /proc
/bin/busybox mount -t sysfs sysfs /sys
/bin/busybox mount -t devtmpfs devtmpfs /dev
for module in /modules/*; do /bin/busybox insmod "$module" || echo "insmod $module failed"; done
/bin/busybox mount -t 9p -o trans=virtio,version=9p2000.L,msize=512000,cache=loose host /mnt || echo "9p failed"
/bin/busybox mount -t proc proc /mnt/proc
/bin/busybox mount -t sysfs sysfs /mnt/sys
/bin/busybox mount -t devtmpfs devtmpfs /mnt/dev
/bin/busybox mkdir -p /mnt/dev/shm
/bin/busybox mount -t tmpfs tmpfs /mnt/dev/shm
/bin/busybox mount -t tmpfs tmpfs /mnt/run
guest=$(/bin/busybox sed 's/.*guest=\\([^ ]*\\).*/\\1/' /proc/cmdline)
/bin/busybox chroot /mnt /bin/sh "$guest"
/bin/busybox sync
echo o > /proc/sysrq-trigger
/bin/busybox sleep 60
"""

GUEST = """export PATH={root}/.venv/bin:/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin
export HOME=/root LC_ALL=C.UTF-8 PYTHONDONTWRITEBYTECODE=1 SERVO_GATEWAY_REQUIRE_VCAN=1 SERVO_GATEWAY_IN_VM=1
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
{exports}mount -t tmpfs tmpfs /dev/shm 2>/dev/null
mkdir -p /dev/shm/tmp && export TMPDIR=/dev/shm/tmp
ip link set lo up
ip link set lo multicast on
ip link add dev vcan0 type vcan
ip link set vcan0 txqueuelen 1000 up
cd {root}
echo
echo "{starts}"
{command}
echo $? > {status}
echo "{ends}"
sync
"""


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
