"""What a node keeps in a lock-step replay, and whose turn it is."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from whereabouts.nodes.messages.stamps import NANOSECONDS
from whereabouts.nodes.ros.turns import (
    GOALS,
    RESTS,
    RESULTS,
    Turns,
    goal_id,
    goals_name,
    kept_name,
    mark_of,
    results_name,
    waits_name,
)
from whereabouts.nodes.runtime.flow import MOST_LEFT, Flow
from whereabouts.nodes.runtime.turn_giver import TurnGiver
from whereabouts_msgs.msg import Connections, Processed

ACTION = "/verify_object"


class StandInInput:
    """Stands for an input. coming : messages that have arrived; handler : called for each that is taken in."""

    def __init__(self, topic: str, handler: Any = None) -> None:
        self.topic, self.handler, self.coming, self.waiting = topic, handler, 0, 0
        self.subscription = topic
        self.counts = SimpleNamespace(received=0)
        self.ended = self.sequence = 0

    def take(self) -> bool:
        if not self.coming:
            return False
        self.coming -= 1
        self.counts.received += 1
        if self.handler is not None:
            self.handler()
        return True

    def tell_loss(self) -> None:
        pass

    def acknowledge(self, stamp: int) -> None:
        self.ended += 1


class TurningNode:
    """Stands for a node in a replay."""

    def __init__(self) -> None:
        self.time = SimpleNamespace(clocks=SimpleNamespace(now=None))
        self.subscriptions = ["/robot/turn", "/scan", "/tf", "/clock"]
        self.replayed = self.active = True
        self.executor = None
        self.inputs: list[StandInInput] = []
        self.acknowledged: list[Any] = []
        self.defects: list[Exception] = []
        self.account = SimpleNamespace(acknowledge=self.acknowledged.append)
        self.turns = Turns(self)  # type: ignore[arg-type]
        self.turns.listen()

    def add_input(self, kind: type, topic: str, handler: Any = None, **_: Any) -> StandInInput:
        self.inputs.append(StandInInput(topic, handler))
        return self.inputs[-1]

    def turn(self, **wanted: int) -> int:
        """A turn with so many messages of each topic in all; how many turns have ended by then."""
        names = [f"/{name}" for name in wanted]
        self.turns.take(Connections(inputs=names, received=[*wanted.values()]), 0)
        self.turns.go_on()
        return self.inputs[0].ended

    def get_fully_qualified_name(self) -> str:
        return "/robot"

    def report_defect(self, where: str, error: Exception) -> None:
        self.defects.append(error)


def test_what_is_kept_is_done_in_one_order_whatever_came_first() -> None:
    robot = TurningNode()
    done: list[int] = []
    for rank in (RESULTS, GOALS, RESTS, RESULTS, GOALS):
        robot.turns.keep(rank, lambda rank=rank: done.append(rank))  # type: ignore[misc]
    robot.turns.keep(RESULTS, lambda: [][0])
    assert robot.turns.counts[kept_name("/robot")] == 6
    robot.turn()
    assert done == [GOALS, GOALS, RESULTS, RESULTS, RESTS]
    assert isinstance(robot.defects[0], IndexError)
    robot.turn()
    assert len(done) == 5


def test_what_is_kept_in_a_turn_is_done_in_it_and_gives_no_other() -> None:
    robot, done = TurningNode(), list[str]()
    scans = robot.add_input(object, "/scan", lambda: robot.turns.keep(RESTS, lambda: done.append("scan")))
    scans.coming = 1
    assert robot.turn(scan=1) == 1
    assert done == ["scan"]
    assert robot.turns.counts[kept_name("/robot")] == 0


def test_who_rests_goes_on_in_a_turn_after_so_much_message_time() -> None:
    robot = TurningNode()
    clocks = robot.time.clocks
    clocks.now = 5 * NANOSECONDS
    rest = robot.turns.rest(2.0)
    rest.send(None)
    robot.turns.look(6 * NANOSECONDS)
    robot.turn()
    rest.send(None)
    robot.turns.look(7 * NANOSECONDS)
    rest.send(None)
    robot.turn()
    with pytest.raises(StopIteration):
        rest.send(None)
    # Time may also go back.
    rest = robot.turns.rest(2.0)
    rest.send(None)
    robot.turns.look(0)
    robot.turn()
    with pytest.raises(StopIteration):
        rest.send(None)


def test_a_turn_ends_when_all_is_there_that_belongs_to_it_and_what_is_kept_comes_last() -> None:
    robot, done = TurningNode(), list[str]()
    robot.turn()
    tf = robot.add_input(object, "/tf", lambda: done.append("tf"))
    scans = robot.add_input(object, "/scan", lambda: done.append("scan"))
    labels = robot.add_input(object, "/labels", lambda: done.append("label"))
    tf.coming = 3
    labels.coming = 1
    robot.turns.keep(GOALS, lambda: done.append("goal"))
    assert robot.turn(scan=1, tf=2, labels=1) == 1
    # The inputs have an order.
    assert done == 3 * ["tf"]
    assert robot.turns.resting == ["/tf", "/clock"]
    scans.coming = 1
    robot.turns.go_on()
    assert done[3:] == ["scan", "label", "goal"]
    assert robot.inputs[0].ended == 2
    assert robot.turns.resting == ["/scan", "/tf", "/clock"]
    # What no turn names is taken in now and then.
    clicks = robot.add_input(object, "/clicked_point")
    clicks.coming = 1
    robot.turn(scan=1)
    assert clicks.coming == 1
    robot.turns.look_around()
    robot.turn(scan=1)
    assert clicks.coming == 0
    assert robot.turns.counts[kept_name("/robot")] == 1
    scans.waiting = 2
    assert robot.turns.counts[waits_name("/robot")] == 2
    # One that is not active leaves all where it is.
    robot.active, scans.coming = False, 1
    assert robot.turn(scan=5) == 5
    assert scans.coming == 1


def test_goals_and_results_are_counted_by_whose_they_are() -> None:
    server, client = TurningNode(), TurningNode()
    server.turns.serves(ACTION)
    server.turn()
    goal = server.turns.begin(ACTION)
    goal.send(None)
    assert server.acknowledged[-1].topic == goals_name(ACTION)
    assert server.acknowledged[-1].received == 1
    server.turn()
    with pytest.raises(StopIteration):
        goal.send(None)
    server.turns.ended(ACTION, SimpleNamespace(goal_id=goal_id("/maintenance")))
    name = results_name(ACTION, mark_of("/maintenance"))
    assert server.turns.counts[name] == 1
    # Without a replay nothing is put off.
    done: list[str] = []
    client.turns.result(name, lambda: done.append("at once"))
    assert done == ["at once"]
    client.turn()
    client.turns.result(name, lambda: done.append("in its turn"))
    assert done == ["at once"]
    client.turn()
    assert done == ["at once", "in its turn"]


def told(names: list[str], inputs: dict[str, list[str]]) -> tuple[TurnGiver, Flow, list[tuple[str, Any]]]:
    """Who gives turns to nodes with these inputs, of which `tf` is lazy; what it is told of; and what it says."""
    given: list[tuple[str, Any]] = []

    def publisher(kind: type, topic: str, depth: int) -> Any:
        return SimpleNamespace(
            publish=lambda turn: given.append((topic, dict(zip(turn.inputs, turn.received, strict=True))))
        )

    flow = Flow(lambda topic: [name for name in names if topic in inputs.get(name, ())])
    node: Any = SimpleNamespace(create_publisher=publisher)
    return TurnGiver(node, names, flow, lambda name: {"/tf"}), flow, given


def answer(giver: TurnGiver, name: str, number: int, topic: str = "turn", waits: int = 0) -> None:
    giver.answered(name, Processed(topic=f"{name}/{topic}", sequence=number), {waits_name(name): waits})


def test_turns_go_to_those_who_are_listened_to_first() -> None:
    names = ["/a/world_maintenance", "/world_model", "/shipped/world_model", "/scan_registration"]
    inputs = {names[0]: ["/world_state"], names[1]: ["/targets"], names[2]: ["/targets"]}
    giver, flow, given = told(names, inputs)
    assert giver.due() == []
    flow.send("/targets")
    flow.send("/world_state")
    assert giver.due() == names[1:3]
    for name in giver.due():
        giver.give(name)
    assert giver.holding == giver.busy == set(names[1:3])
    answer(giver, "/world_model", 1)
    giver.note("/world_model", {kept_name("/world_model"): 1})
    assert giver.holding == giver.busy == {"/shipped/world_model"}
    assert giver.due() == ["/world_model"]
    giver.note("/scan_registration", {kept_name("/scan_registration"): 1})
    assert giver.due() == ["/scan_registration"]
    giver.died("/scan_registration")
    giver.give("/world_model")
    # An answer to the turn before says nothing of this one.
    answer(giver, "/world_model", 1)
    assert "/world_model" in giver.busy
    giver.give("/a/world_maintenance")
    assert giver.due() == []
    assert given == [
        ("/world_model/turn", {"/targets": 1}),
        ("/shipped/world_model/turn", {"/targets": 1}),
        ("/world_model/turn", {}),
        ("/a/world_maintenance/turn", {"/world_state": 1}),
    ]


def test_who_lets_go_keeps_nobody_waiting_but_is_waited_for_in_the_end() -> None:
    giver, flow, _ = told(
        ["/scan_registration", "/tracker"], {"/scan_registration": ["/scan"], "/tracker": ["/odometry"]}
    )
    flow.send("/scan")
    giver.give("/scan_registration")
    flow.send("/odometry")
    answer(giver, "/scan_registration", 1, "free")
    assert (giver.holding, giver.busy) == (set(), {"/scan_registration"})
    assert giver.due() == ["/tracker"]
    giver.give("/tracker")
    answer(giver, "/scan_registration", 1)
    giver.give_up("/tracker")
    assert (giver.holding, giver.busy) == (set(), set())


def test_transforms_give_no_turn_unless_somebody_waits_for_them_or_there_are_many() -> None:
    giver, flow, given = told(["/verifier"], {"/verifier": ["/tf", "/scan"]})
    for _ in range(MOST_LEFT):
        flow.send("/tf")
    assert giver.due() == []
    assert giver.due(last=True) == ["/verifier"]
    flow.send("/scan")
    assert giver.due() == ["/verifier"]
    giver.give("/verifier")
    assert given[-1][1] == {"/tf": MOST_LEFT, "/scan": 1}
    answer(giver, "/verifier", 1, waits=1)
    assert giver.due() == []
    flow.send("/tf")
    assert giver.due() == ["/verifier"]
    giver.give("/verifier")
    answer(giver, "/verifier", 2)
    for _ in range(MOST_LEFT):
        flow.send("/tf")
    assert giver.due() == []
    flow.send("/tf")
    assert giver.due() == ["/verifier"]
