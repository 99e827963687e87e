"""What a node keeps in a lock-step replay, and whose turn it is."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from whereabouts.nodes.messages.stamps import NANOSECONDS
from whereabouts.nodes.ros.turns import (
    GOALS,
    RESULTS,
    Turns,
    goal_id,
    goals_name,
    kept_name,
    mark_of,
    results_name,
)
from whereabouts.nodes.runtime.turn_giver import TurnGiver

ACTION = "/verify_object"


class TurningNode:
    """Stands for a node in a replay."""

    def __init__(self) -> None:
        self.time = SimpleNamespace(clocks=SimpleNamespace(now=None))
        self.replayed = True
        self.executor = None
        self.acknowledged: list[Any] = []
        self.defects: list[Exception] = []
        self.account = SimpleNamespace(acknowledge=self.acknowledged.append)
        self.turns = Turns(self)  # type: ignore[arg-type]

    def get_fully_qualified_name(self) -> str:
        return "/robot"

    def report_defect(self, where: str, error: Exception) -> None:
        self.defects.append(error)


def test_what_is_kept_is_done_in_the_order_of_inputs_whatever_came_first() -> None:
    robot = TurningNode()
    done: list[int] = []
    for rank in (RESULTS, 2, 0, GOALS, 2):
        robot.turns.keep(rank, lambda rank=rank: done.append(rank))  # type: ignore[misc]
    robot.turns.keep(1, lambda: [][0])
    assert robot.turns.counts[kept_name("/robot")] == 6
    robot.turns.take(None, 0)
    assert done == [0, 2, 2, GOALS, RESULTS]
    assert isinstance(robot.defects[0], IndexError)
    robot.turns.take(None, 0)
    assert len(done) == 5


def test_who_rests_goes_on_in_a_turn_after_so_much_message_time() -> None:
    robot = TurningNode()
    clocks = robot.time.clocks
    clocks.now = 5 * NANOSECONDS
    rest = robot.turns.rest(2.0)
    rest.send(None)
    robot.turns.look(6 * NANOSECONDS)
    robot.turns.take(None, 0)
    rest.send(None)
    robot.turns.look(7 * NANOSECONDS)
    rest.send(None)
    robot.turns.take(None, 0)
    with pytest.raises(StopIteration):
        rest.send(None)
    # Time may also go back.
    rest = robot.turns.rest(2.0)
    rest.send(None)
    robot.turns.look(0)
    robot.turns.take(None, 0)
    with pytest.raises(StopIteration):
        rest.send(None)


def test_goals_and_results_are_counted_by_whose_they_are() -> None:
    server, client = TurningNode(), TurningNode()
    server.turns.serves(ACTION)
    server.turns.take(None, 0)
    goal = server.turns.begin(ACTION)
    goal.send(None)
    assert server.acknowledged[-1].topic == goals_name(ACTION)
    assert server.acknowledged[-1].received == 1
    server.turns.take(None, 0)
    with pytest.raises(StopIteration):
        goal.send(None)
    server.turns.ended(ACTION, SimpleNamespace(goal_id=goal_id("/maintenance")))
    name = results_name(ACTION, mark_of("/maintenance"))
    assert server.turns.counts[name] == 1
    # Without a replay nothing is put off.
    done: list[str] = []
    client.turns.result(name, lambda: done.append("at once"))
    assert done == ["at once"]
    client.turns.take(None, 0)
    client.turns.result(name, lambda: done.append("in its turn"))
    assert done == ["at once"]
    client.turns.take(None, 0)
    assert done == ["at once", "in its turn"]


def test_turns_go_to_those_who_are_listened_to_first() -> None:
    names = ["/a/world_maintenance", "/world_model", "/shipped/world_model", "/loop_closure"]
    told: list[str] = []
    node: Any = SimpleNamespace(
        create_publisher=lambda kind, topic, depth: SimpleNamespace(publish=lambda _: told.append(topic))
    )
    giver = TurnGiver(node, names)
    assert giver.due() == []
    for name in names[:3]:
        giver.note(name, {kept_name(name): 2})
    assert giver.due() == ["/world_model", "/shipped/world_model"]
    for name in giver.due():
        giver.give(name)
    assert giver.due() == ["/a/world_maintenance"]
    giver.note("/world_model", {kept_name("/world_model"): 1})
    giver.note("/loop_closure", {kept_name("/loop_closure"): 1})
    assert giver.due() == ["/loop_closure"]
    giver.died("/loop_closure")
    giver.died("/a/world_maintenance")
    assert giver.due() == []
    assert told == ["/world_model/turn", "/shipped/world_model/turn"]
    assert giver.given("/world_model") == 1
