"""`whereabouts mcp` on a store file, asked by the official client over stdio and HTTP."""

from __future__ import annotations

import base64
import json
import os
import socket
import subprocess
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

import anyio
import pytest
from mcp import Client, StdioServerParameters
from mcp.client.stdio import stdio_client
from mcp.client.streamable_http import streamable_http_client

from estimation.errors import InputError
from whereabouts.agents.knowledge import ACTING, Knowledge
from whereabouts.agents.mcp_server import server_of
from world_model import ask

sys.path.append(str(Path(__file__).parents[1] / "world_model"))
from test_questions import lived

ROOT = Path(__file__).parents[2]
READING = ("where_is", "when_last_seen", "history", "what_changed", "what_is_missing", "who_was_here")
COMMAND = ["-m", "whereabouts.cli.main", "mcp"]
TOKEN = "a token of the test's own"


@pytest.fixture
def store(tmp_path: Path) -> Path:
    path = tmp_path / "home.sqlite"
    lived(path).close()
    return path


def environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT), "WHEREABOUTS_TOKEN": TOKEN}


@asynccontextmanager
async def over_stdio(*options: str) -> AsyncIterator[Client]:
    server = StdioServerParameters(command=sys.executable, args=[*COMMAND, *options], env=environment())
    async with Client(stdio_client(server)) as client:
        yield client


async def called(client: Client, tool: str, **arguments: str) -> dict[str, Any]:
    result = await client.call_tool(tool, arguments)
    assert not result.is_error, result.content
    told = result.structured_content
    assert told is not None
    assert 0.0 <= told["probability"] <= 1.0
    assert told["sentence"]
    assert not told["stamp"] or datetime.fromisoformat(told["stamp"]).tzinfo is not None
    return dict(told)


async def reading(client: Client) -> None:
    """What every client can do, whatever the transport."""
    tools = {tool.name: tool for tool in (await client.list_tools()).tools}
    assert {*READING, *ACTING} <= tools.keys()
    assert "class" in tools["relabel"].input_schema["required"]
    assert "from 0 to 1" in tools["where_is"].output_schema["properties"]["probability"]["description"]
    assert (await called(client, "where_is", name="red cup"))["value"] == "kitchen_table"
    assert (await called(client, "where_is", name="cup"))["choices"] == ["cup-1", "cup-2"]
    assert (await called(client, "when_last_seen", name="book"))["value"].startswith("2026-11-17T11")
    assert len((await called(client, "history", name="cup-1"))["value"]) == 7
    changed = await called(client, "what_changed", since="yesterday at 11:00")
    assert changed["value"] == {"cup-1": ["desk", "kitchen_table"], "book-1": ["sofa", None]}
    assert (await called(client, "what_changed", since="2026-11-18T19:30"))["value"] == {}
    assert (await called(client, "what_is_missing"))["value"] == ["book-1"]
    [[person, *_]] = (await called(client, "who_was_here", place="sofa", since="yesterday"))["value"]
    assert person == "person-1"
    nothing = await called(client, "where_is", name='x"; DROP TABLE history; --')
    assert not nothing["ok"]
    assert "cup" in nothing["sentence"]
    assert not (await called(client, "what_changed", since="when pigs fly"))["ok"]
    for tool, given, sentence in (
        ("where_is", {}, "where_is: name is missing."),
        ("where_is", {"name": 5}, "where_is: name must be a valid string."),
        ("ask", {"question": "x" * 501}, "ask: question must have at most 500 characters."),
        ("fly", {}, "There is no tool fly; there are "),
    ):
        result = await client.call_tool(tool, given)
        [said] = [part.text for part in result.content]
        assert result.is_error
        assert said.startswith(sentence), said
        assert "pydantic" not in said
    for tool in ACTING:
        given = {"name": "cup-1", "class": "bowl"} if tool == "relabel" else {"name": "cup-1"}
        told = await called(client, tool, **given)
        assert not told["ok"]
        assert f"--allow {tool}" in told["sentence"]


async def resources(client: Client) -> None:
    names = [str(each.uri) for each in (await client.list_resources()).resources]
    assert set(names) == {"whereabouts://world", "whereabouts://map"}
    world = json.loads((await client.read_resource("whereabouts://world")).contents[0].text)
    assert {item["id"]: item["place"] for item in world["objects"]} == {
        "cup-1": "kitchen_table",
        "cup-2": "counter",
    }
    picture = base64.b64decode((await client.read_resource("whereabouts://map")).contents[0].blob)
    assert picture.startswith(b"\x89PNG")


def test_over_stdio_every_tool_answers_from_the_store(store: Path) -> None:
    async def run() -> None:
        async with over_stdio("--store", str(store)) as client:
            await reading(client)
            await resources(client)

    anyio.run(run)


def test_over_http_only_who_has_the_token_is_answered(store: Path) -> None:
    import httpx2

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [sys.executable, *COMMAND, "--store", str(store), "--http", str(port)]
    server = subprocess.Popen(command, env=environment(), stderr=subprocess.PIPE, text=True)
    url = f"http://127.0.0.1:{port}/mcp"

    async def run() -> None:
        async with httpx2.AsyncClient() as stranger:
            while server.poll() is None:
                try:
                    answer = await stranger.post(url, json={})
                    break
                except httpx2.ConnectError:
                    await anyio.sleep(0.05)
            assert answer.status_code == 401
            assert "Authorization" in answer.json()["error"]
            wrong = await stranger.post(url, json={}, headers={"Authorization": "Bearer guess"})
            assert wrong.status_code == 401
        headers = {"Authorization": f"Bearer {TOKEN}"}
        async with (
            httpx2.AsyncClient(headers=headers, timeout=30.0) as known,
            Client(streamable_http_client(url, http_client=known)) as client,
        ):
            await reading(client)

    try:
        anyio.run(run)
    finally:
        server.terminate()
        server.wait()


def test_what_is_allowed_corrects_the_store(store: Path) -> None:
    async def run() -> None:
        allowed = [word for tool in ACTING for word in ("--allow", tool)]
        async with over_stdio("--store", str(store), *allowed) as client:
            assert (await called(client, "relabel", name="cup-2", **{"class": "bowl"}))["ok"]
            assert (await called(client, "where_is", name="bowl"))["value"] == "counter"
            assert (await called(client, "forget", name="red cup"))["ok"]
            assert (await called(client, "where_is", name="cup-1"))["value"] is None
            assert not (await called(client, "forget", name="unicorn"))["ok"]
            again = await called(client, "forget", name="cup-1")
            assert again["sentence"] == "cup-1 (red) is no longer there: there is nothing to change."
            search = await called(client, "find_object", name="bowl")
            assert "whereabouts run" in search["sentence"]

    anyio.run(run)
    assert ask(store, "where is the red cup?").value is None


def test_why_there_is_no_picture_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    knowledge = Knowledge(None)

    def nothing(call: object) -> None:
        raise InputError("nothing has been seen yet")

    monkeypatch.setattr(knowledge, "ask", nothing)

    async def run() -> None:
        async with Client(server_of(knowledge)) as client:
            with pytest.raises(Exception, match="nothing has been seen yet"):
                await client.read_resource("whereabouts://map")

    anyio.run(run)


def test_what_cannot_be_served_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="fly"):
        Knowledge(None, ("fly",))
    other = tmp_path / "notes.txt"
    other.write_text("no store")
    with pytest.raises(InputError, match="no world model's store"):
        Knowledge(other)
