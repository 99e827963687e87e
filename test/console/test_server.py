"""The console's page and its interfaces, with a source that the tests fill."""

from __future__ import annotations

import base64
import json
import math
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest
from serving import served
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect
from typer.testing import CliRunner
from websockets.sync.client import connect

import whereabouts.console.console_server
from estimation.errors import InputError
from estimation.geometry.places import Places
from whereabouts.cli.main import app
from whereabouts.console.console_server import Console
from whereabouts.console.shown import Shown, empty
from whereabouts.console.sources import ConsoleError, StoreSource
from world_model import WorldObject, WorldState
from world_model.memory.store import Store

TOKEN = "a secret"
KNOWN = {"Authorization": f"Bearer {TOKEN}"}


class ScriptedSource:
    """Says what the test puts into it."""

    live = True

    def __init__(self) -> None:
        self.version = 1
        self.now: Shown = empty()
        self.done: list[tuple[str, dict[str, Any]]] = []
        self.drawn: bytes | None = None

    def world(self) -> Shown:
        return self.now

    def span(self) -> tuple[float, float] | None:
        return 10.0, 20.0

    def world_at(self, stamp: float) -> Shown:
        return {**empty(), "stamp": stamp}

    def picture(self) -> bytes | None:
        return self.drawn

    def ask(self, question: str) -> Shown:
        return {"sentence": f"you asked: {question}", "probability": math.nan}

    def act(self, name: str, arguments: dict[str, Any]) -> str:
        if not arguments:
            raise ConsoleError("say what to find")
        self.done.append((name, arguments))
        return "done"


@pytest.fixture
def source() -> ScriptedSource:
    return ScriptedSource()


@pytest.fixture
def client(source: ScriptedSource) -> Iterator[TestClient]:
    with TestClient(Console(source, TOKEN).app()) as made:
        yield made


def test_the_page_is_small_and_asks_nobody_else(client: TestClient) -> None:
    answer = client.get("/")
    assert answer.status_code == 200
    assert len(answer.content) < 500_000
    assert "http://" not in answer.text
    assert "https://" not in answer.text.replace('https:"', "")
    assert "default-src 'self'" in answer.headers["content-security-policy"]


def test_state_now_and_then(client: TestClient, source: ScriptedSource) -> None:
    source.now = {**empty(), "stamp": 15.0, "people": [{"vx": math.inf}]}
    now = client.get("/api/state").json()
    assert (now["stamp"], now["live"], now["span"]) == (15.0, True, [10.0, 20.0])
    assert now["people"] == [{"vx": None}]
    assert client.get("/api/state?at=12.5").json()["stamp"] == 12.5


@pytest.mark.parametrize("at", ["yesterday", "nan", "1e400", ""])
def test_a_time_that_is_none_is_refused_with_a_sentence(client: TestClient, at: str) -> None:
    answer = client.get("/api/state", params={"at": at})
    assert answer.status_code == 400
    assert "is no time" in answer.json()["error"]


def test_a_map_is_not_kept_for_the_next_console(client: TestClient, source: ScriptedSource) -> None:
    source.drawn = b"PNG"
    answer = client.get("/api/map.png")
    assert (answer.content, answer.headers["cache-control"]) == (b"PNG", "no-store")


def test_questions(client: TestClient) -> None:
    asked = client.get("/api/ask", params={"q": "where is the cup?"}).json()
    assert asked == {"sentence": "you asked: where is the cup?", "probability": None}
    for wrong in ("", " ", "x" * 301):
        assert client.get("/api/ask", params={"q": wrong}).status_code == 400


def test_nothing_is_done_without_the_token(client: TestClient, source: ScriptedSource) -> None:
    for headers in ({}, {"Authorization": "Bearer wrong"}):
        answer = client.post("/api/find", json={"name": "cup"}, headers=headers)
        assert answer.status_code == 403
        assert "token" in answer.json()["error"]
    # In the address it does not count: a link somebody is sent must not act.
    assert client.post(f"/api/find?token={TOKEN}", json={"name": "cup"}).status_code == 403
    assert source.done == []
    assert client.post("/api/find", json={"name": "cup"}, headers=KNOWN).json() == {"sentence": "done"}
    assert source.done == [("find", {"name": "cup"})]


def test_requests_that_make_no_sense_get_a_sentence(client: TestClient) -> None:
    assert client.post("/api/find", json={}, headers=KNOWN).json() == {"error": "say what to find"}
    assert client.post("/api/find", content=b"{", headers=KNOWN).status_code == 400
    assert client.post("/api/find", json=[1], headers=KNOWN).status_code == 400
    assert client.post("/api/reboot", json={}, headers=KNOWN).status_code == 404
    assert client.get("/api/map.png").status_code == 404
    for method, path, status in (("GET", "/api/find", 405), ("POST", "/api/ask/more", 404)):
        answer = client.request(method, path, headers=KNOWN)
        assert answer.status_code == status
        assert answer.json()["error"].startswith(f"{method} {path}: ")


def test_other_names_for_this_machine_and_other_pages_are_refused(source: ScriptedSource) -> None:
    app = Console(source, TOKEN).app()
    with TestClient(app, base_url="http://attacker.example") as stranger:
        assert stranger.get("/api/state").status_code == 400
    with (
        TestClient(app) as client,
        pytest.raises(WebSocketDisconnect),
        client.websocket_connect("/api/live", headers={"origin": "http://attacker.example"}),
    ):
        pass


def test_other_devices_need_the_token_to_look(source: ScriptedSource) -> None:
    with TestClient(Console(source, TOKEN, open_to_all=False).app(), base_url="http://robot:8090") as client:
        assert client.get("/").status_code == 200
        assert client.get("/api/state").status_code == 403
        assert client.get("/api/state", headers=KNOWN).status_code == 200
        with pytest.raises(WebSocketDisconnect), client.websocket_connect("/api/live"):
            pass
        with client.websocket_connect(f"/api/live?token={TOKEN}") as socket:
            assert json.loads(socket.receive_text())["live"]


def test_all_who_look_are_told_what_is_new(client: TestClient, source: ScriptedSource) -> None:
    with client.websocket_connect("/api/live") as first, client.websocket_connect("/api/live") as second:
        for socket in (first, second):
            assert json.loads(socket.receive_text())["stamp"] is None
        source.now = {**empty(), "stamp": 16.0}
        source.version += 1
        for socket in (first, second):
            assert json.loads(socket.receive_text())["stamp"] == 16.0
    assert client.get("/api/state").json()["stamp"] == 16.0


def test_a_viewer_that_takes_nothing_is_given_up_and_others_are_told(
    source: ScriptedSource, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(whereabouts.console.console_server, "STALLED", 3.0)
    # More than what lies between two sockets.
    source.now = {**empty(), "things": [{"id": "x" * 1000}] * 8000}
    console = Console(source, TOKEN)
    with served(console) as port, socket.create_connection(("127.0.0.1", port)) as stalled:
        key = base64.b64encode(bytes(16)).decode()
        stalled.sendall(
            f"GET /api/live HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
        )
        with connect(f"ws://localhost:{port}/api/live", max_size=None) as viewer:
            viewer.recv(timeout=60.0)
            seen: set[int] = set()
            while console.viewers != 1 or len(seen) < 2:
                source.version += 1
                viewer.recv(timeout=60.0)
                seen.add(console.viewers)
            source.now = {**empty(), "stamp": 7.0}
            source.version += 1
            while json.loads(viewer.recv(timeout=60.0))["stamp"] != 7.0:
                pass


def state(step: int) -> WorldState:
    cup = WorldObject(
        "cup-1",
        np.array([0.5 * step, 1.0, 0.8]),
        np.zeros(3),
        np.diag([0.01, 0.04, 0.01]),
        {"class": {"cup": 0.9, "bowl": 0.1}, "color": {"red": 0.8, "green": 0.2}},
        0.98,
        False,
        10.0 * step,
    )
    return WorldState((cup,), 1.0, 1.0, 10.0 * step)


def test_a_file_that_is_no_store_is_refused(tmp_path: Path) -> None:
    (tmp_path / "drive.mcap").write_bytes(b"")
    with pytest.raises(InputError, match="is no world model's store"):
        StoreSource(tmp_path / "drive.mcap")


def test_things_of_a_store_are_at_its_places(tmp_path: Path) -> None:
    with Store(tmp_path / "world.sqlite") as store:
        store.keep_places(
            Places.from_mapping({"places": {"kitchen": {"polygon": [[0, 0], [3, 0], [3, 3], [0, 3]]}}})
        )
        store.record(state(2))
        source = StoreSource(tmp_path / "world.sqlite")
        assert [item["place"] for item in source.world()["things"]] == ["kitchen"]
        source.close()


def test_a_store_is_shown_as_it_was_at_any_time(tmp_path: Path) -> None:
    path = tmp_path / "world.sqlite"
    with Store(path) as store:
        for step in range(10):
            store.record(state(step))
        source = StoreSource(path)
        with TestClient(Console(source, TOKEN).app()) as client:
            now = client.get("/api/state").json()
            assert (now["span"], now["things"][0]["x"]) == ([0.0, 90.0], 4.5)
            then = client.get("/api/state?at=35").json()["things"][0]
            assert (then["x"], then["class"], then["color"], then["spread"]) == (1.5, "cup", "red", 0.2)
            # What is written while the page is open shows by itself.
            store.record(state(10))
            assert client.get("/api/state").json()["things"][0]["x"] == 5.0
            assert "cup" in client.get("/api/ask", params={"q": "where is the cup?"}).json()["sentence"]
            refused = client.post("/api/find", json={"name": "cup"}, headers=KNOWN)
            assert refused.status_code == 400
        source.close()


def test_the_address_that_is_printed_leads_to_the_token(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "world.sqlite"
    Store(path).close()
    monkeypatch.setattr("uvicorn.Server.run", lambda self: None)
    given = ["console", "--store", str(path), "--port", "8097", "--token", "a b&c+d"]
    shown = CliRunner().invoke(app, given).output
    address = shown.split()[2]
    assert parse_qs(urlsplit(address).fragment) == {"token": ["a b&c+d"]}
