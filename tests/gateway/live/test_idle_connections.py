"""Connections that ask for nothing do not keep the page from opening, over real sockets of this computer."""

from __future__ import annotations

import asyncio
import contextlib
import resource
import socket

import pytest
import uvicorn

from gateway.live import page_process
from gateway.live.guard import Door
from gateway.live.page_content import Show
from gateway.live.page_process import MOST_WAITING, PunctualProtocol, config_of, most_connections
from gateway.live.server import Pages, live_app
from gateway.live.wire import Hello

TOKEN = "the-word"


@contextlib.asynccontextmanager
async def served():
    """Port of a page that is being served in this thread."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        show = Show(Hello(port, TOKEN, "servo-gateway record", stops=True))
        server = uvicorn.Server(config_of(live_app(Pages(show, lambda: None), Door(port, TOKEN))))
        with contextlib.ExitStack() as quiet:
            quiet.enter_context(contextlib.suppress(asyncio.CancelledError))
            serving = asyncio.create_task(server.serve([listener]))
            while not server.started:
                await asyncio.sleep(0.001)
            try:
                yield port
            finally:
                server.should_exit = True
                await serving


async def asked(port: int, text: str = "") -> bytes:
    """First line of the answer to a request."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    request = f"GET /?token={TOKEN} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nConnection: close\r\n{text}\r\n"
    writer.write(request.encode())
    line = await reader.readline()
    writer.close()
    return line


def test_the_page_opens_beside_any_number_of_idle_connections():
    async def scenario() -> None:
        async with served() as port:
            idle = [await asyncio.open_connection("127.0.0.1", port) for _ in range(460)]
            assert (await asked(port)).startswith(b"HTTP/1.1 200")
            assert len(PunctualProtocol.waiting) <= MOST_WAITING
            for _, writer in idle:
                writer.close()

    asyncio.run(scenario())


@pytest.mark.parametrize("sent", [b"", b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n", b"\x16\x03\x01"])
def test_a_connection_without_a_whole_request_is_closed(monkeypatch, sent):
    monkeypatch.setattr(page_process, "REQUEST_S", 0.05)

    async def scenario() -> bytes:
        async with served() as port:
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(sent)
            with contextlib.suppress(ConnectionResetError):
                answer = await asyncio.wait_for(reader.read(), 5.0)
                assert not answer or answer.startswith(b"HTTP/1.1 400")
            writer.close()
            assert not PunctualProtocol.waiting
            return await asked(port)

    assert asyncio.run(scenario()).startswith(b"HTTP/1.1 200")


def test_an_open_feed_is_not_closed_for_being_quiet(monkeypatch):
    monkeypatch.setattr(page_process, "REQUEST_S", 0.05)

    async def scenario() -> None:
        async with served() as port:
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(
                f"GET /feed?token={TOKEN} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nOrigin: http://127.0.0.1:{port}\r\n"
                "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
                "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n".encode()
            )
            assert (await reader.readline()).startswith(b"HTTP/1.1 101")
            await asyncio.sleep(0.2)
            assert not reader.at_eof()
            writer.close()

    asyncio.run(scenario())


def test_fewer_connections_than_descriptors(monkeypatch):
    monkeypatch.setattr(resource, "getrlimit", lambda _what: (256, 4096))
    assert most_connections(400) == 64
    monkeypatch.setattr(resource, "getrlimit", lambda _what: (1024, 4096))
    assert most_connections(400) == 400
