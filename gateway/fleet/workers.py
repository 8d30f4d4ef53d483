"""Distribute work over processes with Dask, on this computer or on a cluster.

The number of submitted tasks is limited, so that memory does not grow with their number. A task of a killed worker is
repeated by another one.
"""

from __future__ import annotations

import socket
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, Final, Protocol, TypeVar

from gateway.errors import ConfigError, GatewayError
from gateway.fleet.columns import library

Item = TypeVar("Item")
Done = TypeVar("Done")
#: How long a scheduler may take to answer [s].
PATIENCE_S: Final = 15.0
#: Tasks handed out for every worker: one that it does, and the next one.
_AHEAD: Final = 2


class Spreading(Protocol):
    """Applies a function to many items and yields each with its result or `GatewayError`, in any order."""

    def __call__(
        self, function: Callable[[Item], Done], items: Iterable[Item]
    ) -> Iterator[tuple[Item, Done | GatewayError]]: ...


@contextmanager
def workers(scheduler: str | None, count: int | None = None) -> Generator[Spreading]:
    """Provide the workers of a cluster, or of this computer if no scheduler is named.

    Certificates of a scheduler at a tls:// address, and everything else about Dask, are stated in Dask's own
    configuration (`distributed.comm.tls`).

    Parameters
    ----------
    scheduler : str or None
        Address, such as tcp://10.0.0.5:8786.
    count : int, optional
        Processes on this computer; one per processor if omitted.

    Raises
    ------
    ConfigError
        The scheduler does not answer, or stops answering; unusable certificates.
    """
    distributed = library("distributed")
    if scheduler is not None:
        if scheduler.startswith("tls://"):
            tls = library("dask").config.get("distributed.comm.tls")
            try:
                # A client's certificate file may hold its key as well; then no key is stated.
                usable = distributed.Security().get_connection_args("client").get("ssl_context")
                reason = "" if usable else "the authority's file or the client's is not named"
            except (OSError, ValueError) as error:
                reason = str(error)
            if reason:
                files = f"ca-file {tls['ca-file']}, client.cert {tls['client']['cert']}, key {tls['client']['key']}"
                raise ConfigError(
                    f"--scheduler {scheduler}: the certificates ({files}) cannot be used for TLS: {reason}; name PEM"
                    " files in the configuration of Dask (distributed.comm.tls: ca-file, client.cert, client.key)"
                )
        place = scheduler.partition("://")[2] or scheduler
        host, _, port = place.rpartition(":")
        try:
            socket.create_connection((host.strip("[]"), int(port)), timeout=PATIENCE_S).close()
        except (OSError, ValueError, OverflowError) as error:
            raise ConfigError(_no_answer(scheduler)) from error
    library("dask").config.set({"distributed.comm.timeouts.connect": f"{PATIENCE_S}s"})
    cluster: Any = None
    client: Any = None
    try:
        if scheduler is None:
            cluster = distributed.LocalCluster(
                n_workers=count,
                threads_per_worker=1,
                processes=True,
                dashboard_address=None,
                silence_logs="CRITICAL",
            )
        try:
            client = distributed.Client(cluster or scheduler, timeout=PATIENCE_S, set_as_default=False)
        except (OSError, ValueError) as error:
            raise ConfigError(f"{_no_answer(str(scheduler))} ({error})") from error
        yield _Dask(client, scheduler or "the workers of this machine")
    finally:
        with suppress(OSError, TimeoutError):
            if client is not None:
                client.close(timeout=1.0)
            if cluster is not None:
                cluster.close(timeout=10.0)


def _no_answer(scheduler: str) -> str:
    return (
        f"--scheduler {scheduler}: no scheduler responds; start one (dask scheduler), or omit --scheduler to work"
        " on this machine"
    )


class _Dask:
    """Tasks submitted through a Dask client."""

    def __init__(self, client: Any, where: str) -> None:
        self._client = client
        self._where = where

    def __call__(
        self, function: Callable[[Item], Done], items: Iterable[Item]
    ) -> Iterator[tuple[Item, Done | GatewayError]]:
        """Apply a function to many items, as `Spreading`.

        Raises
        ------
        ConfigError
            The scheduler stopped, or there is no worker; yielded items are complete.
        """
        waiting = iter(items)
        threads = sum(self._client.nthreads().values())
        if not threads:
            raise ConfigError(f"{self._where}: has no worker; start one (dask worker ADDRESS)")
        finished = library("distributed").as_completed(loop=self._client.loop, raise_errors=False)
        items_of: dict[str, Item] = {}

        def hand_out() -> None:
            for item in waiting:
                future = self._client.submit(guarded, function, item, pure=False)
                items_of[future.key] = item
                finished.add(future)
                return

        for _ in range(_AHEAD * threads):
            hand_out()
        for future in finished:
            item = items_of.pop(future.key)
            yield item, self._result(future)
            future.release()
            hand_out()

    def _result(self, future: Any) -> Any:
        if future.status == "finished":
            return future.result()
        if future.status == "error":
            error = future.exception()
            if isinstance(error, library("distributed").KilledWorker):
                return GatewayError("every worker that executed it was killed; give the workers more memory")
            raise error
        raise ConfigError(
            f"{self._where}: the scheduler connection was lost; run the command again: completed results are stored"
        )


def guarded(function: Callable[[Item], Done], item: Item) -> Done | GatewayError:
    """Return an error of the data as a result; other exceptions are defects and propagate."""
    try:
        return function(item)
    except GatewayError as error:
        return error
