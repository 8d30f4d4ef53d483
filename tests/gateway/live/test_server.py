"""Who is answered: a browser on this computer with the address that was printed, no one else; what the button does."""

from __future__ import annotations

import asyncio
import json
import warnings
from collections.abc import Iterator
from unittest.mock import Mock

import pytest
from starlette.websockets import WebSocketDisconnect

from gateway.live.guard import Door
from gateway.live.page_content import Show
from gateway.live.server import BEHIND, STATIC, Pages, Viewer, live_app
from gateway.live.wire import Hello

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # the client says that its library has a successor
    from starlette.testclient import TestClient

PORT, TOKEN = 8460, "the-word"
HOME = f"http://127.0.0.1:{PORT}"
SOCKET = f"ws://127.0.0.1:{PORT}/feed"


@pytest.fixture
def stopped() -> Mock:
    return Mock()


@pytest.fixture
def client(shown, stopped) -> Iterator[TestClient]:
    show = Show(Hello(PORT, TOKEN, "servo-gateway record", stops=True))
    show.take(shown)
    with TestClient(live_app(Pages(show, stopped), Door(PORT, TOKEN)), base_url=HOME) as client:
        yield client


def test_the_address_that_is_printed_opens_the_page(client):
    answer = client.get(Door(PORT, TOKEN).address)
    assert answer.status_code == 200
    assert '<button id="stop"' in answer.text
    assert "default-src 'none'" in answer.headers["content-security-policy"]
    assert answer.headers["referrer-policy"] == "no-referrer"


def test_nothing_of_the_page_is_fetched_from_elsewhere(client):
    text = client.get(f"/?token={TOKEN}").text
    for part in STATIC:
        assert f"/static/{part}?token={TOKEN}" in text
        answer = client.get(f"/static/{part}?token={TOKEN}")
        assert answer.status_code == 200
        assert len(answer.content) > 500
        text += answer.text if part.endswith("css") else ""
    assert "https://" not in text
    assert 'src="http' not in text
    assert client.get(f"/static/../feed.py?token={TOKEN}").status_code == 404
    assert client.get(f"/static/feed.py?token={TOKEN}").status_code == 404


@pytest.mark.parametrize(
    ("headers", "token"),
    [
        ({"host": "robot.example:8460"}, TOKEN),
        ({"host": "127.0.0.1.example:8460"}, TOKEN),
        ({"host": "127.0.0.1"}, TOKEN),
        ({"host": "192.168.1.7:8460"}, TOKEN),
        ({"origin": "http://evil.example"}, TOKEN),
        ({"origin": "http://127.0.0.1:8461"}, TOKEN),
        ({"origin": "null"}, TOKEN),
        ({}, ""),
        ({}, "another"),
    ],
)
@pytest.mark.parametrize("path", ["/", "/static/live.js", "/feed"])
def test_everybody_else_is_refused_and_nothing_is_stopped(client, stopped, headers, token, path):
    if path == "/feed":
        with pytest.raises(WebSocketDisconnect), client.websocket_connect(f"{SOCKET}?token={token}", headers=headers):
            pass
    else:
        answer = client.get(f"{path}?token={token}", headers=headers)
        assert answer.status_code == 403
        assert "address" in answer.text
    stopped.assert_not_called()


@pytest.mark.parametrize("origin", [HOME, f"http://localhost:{PORT}"])
def test_the_button_is_received_and_no_other_word(client, stopped, origin):
    with client.websocket_connect(f"{SOCKET}?token={TOKEN}", headers={"origin": origin}) as socket:
        assert json.loads(socket.receive_text())["hello"]["title"] == "servo-gateway record"
        assert "scene" in json.loads(socket.receive_text())
        for word in ("move", "stop now", "", "stop", "stop"):
            socket.send_text(word)
        socket.close()
    assert stopped.call_count == 2


def test_words_are_sent_before_frames_and_old_frames_are_left_out():
    async def taken() -> list[str]:
        viewer = Viewer(['{"hello"}'])
        viewer.put([f'{{"frame": {number}}}' for number in range(50)])
        viewer.put(['{"event"}'])
        return [await viewer.next() for _ in range(2 + BEHIND)]

    assert asyncio.run(taken()) == ['{"hello"}', '{"event"}', *(f'{{"frame": {number}}}' for number in range(46, 50))]
