"""The running suite asked and told from outside: questions, forgetting, a search that is cancelled."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import anyio
import pytest
from harness import Graph
from mcp import Client as McpClient
from mcp import StdioServerParameters
from mcp.client.stdio import stdio_client
from rclpy.action.server import ActionServer, CancelResponse
from rclpy.task import Future
from test_world_model import ON_COUNTER, ON_TABLE, World, seen

from estimation.geometry.places import Places
from whereabouts.nodes.live import live_actions, searching
from whereabouts.nodes.live import live_world as live_world_module
from whereabouts.nodes.live.live_actions import act, find, goal_for
from whereabouts.nodes.live.live_world import PATIENCE, Client, NoWorldError, live_world
from whereabouts_msgs.action import FindObject
from whereabouts_msgs.msg import WorldObject
from world_model import WorldState, ask
from world_model.memory.store import Store


@pytest.fixture
def client(domain: int) -> Any:
    made = Client()
    yield made
    made.close()


@pytest.mark.parametrize("remembers", [True, False])
def test_the_live_world_is_asked_and_told(
    graph: Graph, client: Client, tmp_path: Path, remembers: bool
) -> None:
    world = World(graph, **({"store_path": str(tmp_path / "world.sqlite")} if remembers else {}))
    world.look(0.0, 12, seen(ON_TABLE, "cup", "red"), seen(ON_COUNTER, "cup", "blue"))
    with live_world(client) as known:
        assert ask(known, "where is the red cup?").value == "kitchen_table"
        [cup] = [item.id for item in known.present.values() if item.most_probable("color") == "red"]
        assert goal_for(cup, known).object_id == cup
        [other] = {item.id for item in known.present.values()} - {cup}
        assert goal_for("the cup on the counter", known).object_id == other
        for words in ("red mugs", "the red cup"):
            goal = goal_for(words, known)
            assert (goal.object_id, goal.class_name, list(goal.predicates)) == ("", "cup", ["red"])
    assert act(client, "forget", object_id=cup).ok

    def forgotten() -> bool:
        with live_world(client) as known:
            return ask(known, "where is the red cup?").value is None

    graph.until(forgotten, "a world without the cup")
    assert not act(client, "forget", object_id="cup-99").ok


def test_without_a_node_it_is_said(client: Client) -> None:
    with pytest.raises(NoWorldError, match="whereabouts run"), live_world(client):
        pass


def test_who_is_not_there_is_not_waited_for_as_long_as_an_answer(
    client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    waited: list[float] = []

    def until(self: Client, done: Any, seconds: float = PATIENCE) -> bool:
        waited.append(seconds)
        return False

    monkeypatch.setattr(Client, "until", until)
    with pytest.raises(NoWorldError, match="nobody offers loop_closure/save_map"):
        live_actions.act(client, "save_map", path="")
    assert waited == [PATIENCE]


def test_a_world_model_that_has_seen_nothing_is_not_to_be_started(
    graph: Graph, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_world_module, "PATIENCE", 0.2)
    World(graph)
    graph.until(lambda: client.node.count_publishers("world_state"), "the world model is seen")
    with pytest.raises(NoWorldError, match="runs, but nothing has been seen yet"), live_world(client):
        pass


def test_a_suite_in_another_namespace_is_told_of(graph: Graph, client: Client) -> None:
    graph.start("loop_closure", namespace="/robot1")
    graph.until(lambda: client.elsewhere("map"), "the other namespace is seen")
    with pytest.raises(NoWorldError, match="There is one with --namespace /robot1"):
        live_actions.act(client, "save_map", path="")


def test_other_places_are_those_of_the_question(graph: Graph, client: Client) -> None:
    world = World(graph)
    world.look(0.0, 12, seen(ON_TABLE, "cup", "red"))
    around = [[ON_TABLE[0] + x, ON_TABLE[1] + y] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    stage = Places.from_mapping({"places": {"stage": {"polygon": around, "kind": "furniture"}}})
    with live_world(client, stage) as known:
        assert ask(known, "where is the red cup?").value == "stage"


def test_a_store_that_is_not_the_one_of_the_node_is_not_asked(
    graph: Graph, client: Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    world, path = World(graph), tmp_path / "world.sqlite"
    world.look(0.0, 12, seen(ON_TABLE, "cup", "red"))
    with Store(path) as other:
        other.record(WorldState((), 1.0, 0.0, 500.0))
    monkeypatch.setattr(Client, "parameters", lambda self, *names: [str(path), "", ""])
    with live_world(client) as known:
        assert known.store is None
        assert set(known.present) == {"cup-1"}


def test_a_search_tells_its_steps_and_is_cancelled(
    graph: Graph, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Who answers is spun by this thread, too: there is nothing to wait for.
    monkeypatch.setattr(live_actions, "PATIENCE", 0.2)
    cancelled: list[bool] = []

    async def search(handle: Any) -> FindObject.Result:
        while not handle.is_cancel_requested:
            handle.publish_feedback(FindObject.Feedback(reason="no cup seen", probability=0.4, kind="room"))
            await _soon(graph)
        cancelled.append(True)
        handle.canceled()
        return FindObject.Result(code=FindObject.Result.CANCELED)

    server = ActionServer(
        graph.node, FindObject, "find_object", search, cancel_callback=lambda handle: CancelResponse.ACCEPT
    )
    steps: list[tuple[str, float]] = []

    def spun() -> bool:
        graph.executor.spin_once(timeout_sec=0.01)
        return bool(steps)

    done = find(client, goal_for("red cup", None), lambda reason, p: steps.append((reason, p)), spun)
    assert not done.ok
    assert steps[0] == ("no cup seen", 0.4)
    graph.until(lambda: bool(cancelled), "the search is cancelled")
    server.destroy()


def test_a_search_that_failed_has_found_nothing(graph: Graph, client: Client) -> None:
    def fail(handle: Any) -> FindObject.Result:
        handle.abort()
        return FindObject.Result()

    server = ActionServer(graph.node, FindObject, "find_object", fail)

    def spun() -> bool:
        graph.executor.spin_once(timeout_sec=0.01)
        return False

    done = find(client, goal_for("red cup", None), stopped=spun)
    assert (done.ok, done.sentence) == (False, "The search failed; its log says why.")
    server.destroy()


@pytest.mark.parametrize("started_anew", [False, True])
def test_a_search_ends_with_the_node_that_searched(
    graph: Graph, client: Client, monkeypatch: pytest.MonkeyPatch, started_anew: bool
) -> None:
    monkeypatch.setattr(searching, "GONE", 100 if started_anew else 2)

    async def search(handle: Any) -> FindObject.Result:
        handle.publish_feedback(FindObject.Feedback(reason="no cup seen"))
        await Future(executor=graph.executor)
        return FindObject.Result()

    def until(done: Callable[[], bool], what: str) -> None:
        graph.until(lambda: client.spin() or done(), what)

    server = ActionServer(graph.node, FindObject, "find_object", search)
    searches, steps = searching.Searches(client.node), []
    until(lambda: searches.ready, "somebody searches")
    asked = searches.ask(goal_for("red cup", None), steps.append)
    until(lambda: bool(steps), "a step of the search")
    server.destroy()
    until(lambda: searches._gone > 0, "nobody searches")
    if started_anew:
        server = ActionServer(graph.node, FindObject, "find_object", search)
    until(lambda: asked.result is not None, "the search is over")
    assert "its log says why" in asked.result.message
    searches.destroy()
    if started_anew:
        server.destroy()


async def _soon(graph: Graph) -> None:
    """Give way once."""
    future: Future = Future(executor=graph.executor)
    timer = graph.node.create_timer(0.02, lambda: future.done() or future.set_result(None))
    await future
    graph.node.destroy_timer(timer)


def test_words_become_a_goal() -> None:
    goal = goal_for("the small red cup", None)
    assert (goal.class_name, list(goal.predicates), goal.object_id) == ("cup", ["small", "red"], "")


def test_an_agent_searches_with_the_robot_and_hears_how_it_goes(graph: Graph) -> None:
    async def search(handle: Any) -> FindObject.Result:
        for _ in range(3):
            handle.publish_feedback(FindObject.Feedback(reason="no cup seen", probability=0.4, kind="room"))
            await _soon(graph)
        handle.succeed()
        found = WorldObject(id="cup-7", place="kitchen_table", existence_probability=0.95)
        return FindObject.Result(code=FindObject.Result.FOUND, object=[found], distance=2.0)

    server = ActionServer(graph.node, FindObject, "find_object", search)
    progress: list[str] = []
    results: list[dict[str, Any]] = []

    async def hear(share: float, total: float | None, message: str | None) -> None:
        progress.append(message or "")

    async def talk() -> None:
        command = ["-m", "whereabouts.cli.main", "mcp", "--allow", "find_object"]
        process = StdioServerParameters(command=sys.executable, args=command, env=dict(os.environ))
        async with McpClient(stdio_client(process)) as agent:
            for tool in ("find_object", "forget", "where_is"):
                heard = hear if tool == "find_object" else None
                answer = await agent.call_tool(tool, {"name": "red cup"}, progress_callback=heard)
                results.append(dict(answer.structured_content or {}))

    talking = threading.Thread(target=lambda: anyio.run(talk))
    talking.start()
    graph.until(lambda: not talking.is_alive(), "the agent has its answers")
    found, forgot, nothing = results
    assert found["ok"]
    assert (found["value"], found["probability"]) == ("cup-7", 0.95)
    assert "kitchen table" in found["sentence"]
    assert "no cup seen (p = 0.40)" in progress
    assert "--allow forget" in forgot["sentence"]
    assert not nothing["ok"]
    assert "whereabouts run" in nothing["sentence"]
    server.destroy()
