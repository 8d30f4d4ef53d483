"""Work spread over processes: nothing is lost with a worker, no more is taken than is done, errors are named."""

from __future__ import annotations

import json
import re
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import dask
import distributed
import pytest

from gateway.errors import ConfigError
from gateway.fleet import workers as module
from gateway.fleet.workers import workers

ROOT = Path(__file__).parents[3]
#: In a process of its own: Dask's loop stays in the one that has used it.
PROGRAM = """
import json, sys
from gateway.fleet.workers import workers
from gateway.errors import DataUnusable
from tests.data.fleets import double_unless_killed, spoilt

taken, ahead, results = 0, 0, {}

def tasks():
    global taken
    for number in range(12):
        taken += 1
        yield number, sys.argv[1]

if __name__ == "__main__":
    with workers(None, 1) as spread:
        for task, done in spread(double_unless_killed, tasks()):
            results[task[0]] = done
            ahead = max(ahead, taken - len(results))
        answers = dict(spread(spoilt, [0, 1]))
        assert answers[0] == 0
        assert isinstance(answers[1], DataUnusable)
        try:
            list(spread(spoilt, [2]))
        except ZeroDivisionError:
            print(json.dumps([ahead, results]))
"""


def ran(folder: Path, text: str, *words: object) -> subprocess.CompletedProcess[str]:
    """A program in a process of its own, with words of its command line."""
    program = folder / "program.py"
    program.write_text(text)
    done = subprocess.run(
        [sys.executable, program, *map(str, words)], capture_output=True, text=True, cwd=ROOT, timeout=120,
        env={"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin", "OPENBLAS_NUM_THREADS": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done


@pytest.mark.slow
def test_killed_worker_loses_nothing_and_an_error_of_the_data_is_an_answer_and_a_defect_is_not(tmp_path: Path) -> None:
    done = ran(tmp_path, PROGRAM, tmp_path / "mark")
    ahead, results = json.loads(done.stdout)
    assert (tmp_path / "mark").exists()
    assert results == {str(number): 2 * number for number in range(12)}
    assert ahead <= 2


def test_scheduler_that_is_not_there_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "PATIENCE_S", 0.2)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    with pytest.raises(ConfigError, match=f"--scheduler {address}: no scheduler responds"), workers(address):
        pass


#: A scheduler that is killed once the first task is done: what was done is given, then one sentence.
GONE = """
import subprocess, sys
from gateway.errors import ConfigError
from gateway.fleet import workers as module
from tests.data.fleets import slowly_doubled

def started(words, said):
    program = subprocess.Popen([sys.executable, "-m", *words], stderr=subprocess.PIPE, text=True)
    for line in program.stderr:
        if said in line:
            return program, line
    raise SystemExit("it did not start")

if __name__ == "__main__":
    module.PATIENCE_S = 2.0
    scheduler, line = started(
        ["distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"], "Scheduler at:"
    )
    address = line.split()[-1]
    worker = None
    try:
        if sys.argv[1] == "worker":
            worker, _ = started(
                ["distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard"],
                "Registered to:",
            )
        done = []
        try:
            with module.workers(address) as spread:
                for task, _ in spread(slowly_doubled, range(200)):
                    done.append(task)
                    if len(done) == 2:
                        scheduler.kill()
        except ConfigError as error:
            print(len(done) >= 2, error)
    finally:
        for program in (scheduler, worker):
            if program is not None:
                program.kill()
                program.communicate()
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cluster", "said"),
    [
        (
            "worker",
            "True .*: the scheduler connection was lost; run the command again: completed results are stored",
        ),
        ("no worker", r"False .*: has no worker; start one \(dask worker ADDRESS\)"),
    ],
)
def test_cluster_that_goes_away_or_has_no_worker_gives_one_line(tmp_path: Path, cluster: str, said: str) -> None:
    done = ran(tmp_path, GONE, cluster)
    assert re.fullmatch(said, done.stdout.strip()), done.stdout + done.stderr


# -- who may connect ---------------------------------------------------------------------------------------------------


def _certificates(folder: Path, name: str) -> list[Path]:
    """An authority of its own and a certificate of it with its key, by openssl."""
    files = authority, certificate, own_key = [folder / f"{name}-{part}.pem" for part in ("ca", "cert", "key")]
    authority_key, request = folder / f"{name}-ca-key.pem", folder / f"{name}.csr"
    key = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-subj"]
    for words in (
        ["req", "-x509", "-days", "2", *key, "/CN=authority", "-keyout", authority_key, "-out", authority],
        ["req", *key, "/CN=cluster", "-keyout", own_key, "-out", request],
        ["x509", "-req", "-days", "2", "-in", request, "-CA", authority, "-CAkey", authority_key,
         "-CAcreateserial", "-out", certificate],
    ):  # fmt: skip
        subprocess.run(["openssl", *map(str, words)], check=True, capture_output=True)
    return files


#: A cluster with TLS on this machine, and what comes of the client whose files the configuration of Dask names.
TLS = """
import sys
import dask
from distributed import LocalCluster, Security
from gateway.errors import ConfigError
from gateway.fleet import workers as module

if __name__ == "__main__":
    module.PATIENCE_S = 3.0
    names = [str(name) for name in sys.argv[1:]]
    authority, certificate, key = names[:3]
    security = Security(
        tls_ca_file=authority, tls_scheduler_cert=certificate, tls_scheduler_key=key, tls_worker_cert=certificate,
        tls_worker_key=key, tls_client_cert=certificate, tls_client_key=key, require_encryption=True,
    )
    with LocalCluster(
        n_workers=1, processes=False, protocol="tls", security=security, dashboard_address=None, silence_logs="CRITICAL"
    ) as cluster:
        try:
            authority, certificate, key = names[3:]
            dask.config.set({
                "distributed.comm.tls.ca-file": authority, "distributed.comm.tls.client.cert": certificate,
                "distributed.comm.tls.client.key": key,
            })
            with module.workers(cluster.scheduler_address) as spread:
                print(sorted(spread(abs, [-1, 2])))
        except ConfigError:
            print("refused")
"""


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl makes the certificates")
@pytest.mark.parametrize(("client", "said"), [("own", "[(-1, 1), (2, 2)]"), ("foreign", "refused")])
def test_a_cluster_with_certificates_works_for_their_holders(tmp_path: Path, client: str, said: str) -> None:
    files = {name: _certificates(tmp_path, name) for name in ("own", "foreign")}
    done = ran(tmp_path, TLS, *files["own"], *files[client])
    assert said in done.stdout


@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl makes the certificates")
@pytest.mark.parametrize(
    ("stated", "said"),
    [
        ((), "not named"),
        (("absent", "absent", "absent"), r"absent\.pem"),
        (("words", "words", "words"), "cannot be used for TLS"),
        # A client's certificate file may hold its key as well: taken, and the call ends at the address.
        (("own-ca", "both"), "no scheduler responds"),
    ],
)
def test_unusable_certificates_are_named_before_a_scheduler_is_called(tmp_path: Path, stated, said: str) -> None:
    _, certificate, key = _certificates(tmp_path, "own")
    (tmp_path / "both.pem").write_text(certificate.read_text() + key.read_text())
    (tmp_path / "words.pem").write_text("no certificate")
    # The defaults are read before a file is stated: Dask takes away at the end what was absent at the start.
    assert distributed.config["distributed"]
    keys = [f"distributed.comm.tls.{key}" for key in ("ca-file", "client.cert", "client.key")]
    files = dict(zip(keys, [str(tmp_path / f"{name}.pem") for name in stated], strict=False))
    with dask.config.set(files), pytest.raises(ConfigError, match=said), module.workers("tls://127.0.0.1:1"):
        pass
