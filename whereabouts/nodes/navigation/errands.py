"""Who moves the base, and the searches that `world_maintenance` has made for what is lost while nobody else does.

Who has the base: a person's request before a search for what is lost, and that before maintenance. Who has to wait
says so. `object_search` knows the errands of maintenance by the ids of their goals, and ends one for whatever a person
wants.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from std_msgs.msg import Bool

from whereabouts.nodes.messages.stamps import duration_message
from whereabouts.nodes.ros.base import SuiteNode
from whereabouts.nodes.ros.qos import LATCHED
from whereabouts.nodes.ros.turns import MARK, mark_of
from whereabouts_msgs.action import FindObject
from world_model import WorldState

SENDER = "world_maintenance"
LONGEST = 120.0
"""s of a search that no person asked for."""
AGAIN = 2.0
"""s until a search that had to make way is asked for again; longer than the news of who has the base needs."""


def is_errand(node: SuiteNode, handle: Any) -> bool:
    """Whether a goal of `find_object` comes from the maintenance of the same namespace."""
    sender = node.resolve_topic_name(SENDER)
    return bytes(handle.goal_id.uuid)[:MARK] == mark_of(sender)


class Errands:
    """What is lost and wanted, and the search for one of it.

    complain : called with a sentence where a search cannot be had.

    sent : searches that were asked for. said : what is under way, or what is waited for, in words.
    """

    def __init__(self, node: SuiteNode, complain: Callable[[str], None]) -> None:
        self._caller = node.add_caller(FindObject, "find_object")
        self._complain = complain
        self._run = 0
        self.forget()

    def forget(self) -> None:
        self._waiting: dict[str, str] = {}
        self._searching = ""
        self._not_before = -float("inf")
        self._run += 1
        self.sent = 0
        self.said = ""

    @property
    def busy(self) -> bool:
        """Whether anything lost is searched for, or waits."""
        return bool(self._searching or self._waiting)

    def add(self, object_id: str, class_name: str) -> None:
        """An object that somebody wants is lost."""
        self._waiting[object_id] = class_name

    def broken_off(self, now: float) -> bool:
        """Whether the search is over at `now`, s, without an answer: who searched has ended, or was started anew."""
        over = not self._caller.ready or now > self._not_before + LONGEST
        broken = bool(self._searching) and over
        if broken:
            self._searching = ""
            self._run += 1
        return broken

    def look(self, state: WorldState, available: bool, now: float) -> bool:
        """Send the next search where the base is free, at `now`, s; whether maintenance has to leave the base alone."""
        if self._searching:
            return True
        here = {item.id for item in state.objects if not item.lost}
        self._waiting = {name: kind for name, kind in self._waiting.items() if name not in here}
        if not self._waiting:
            return False
        name, kind = next(iter(self._waiting.items()))
        if not self._caller.ready:
            self._complain(f"{name} is lost, and no node offers the action find_object")
            self._waiting.clear()
            return False
        if not available or now < self._not_before:
            self.said = f"{name} is lost: the search for it waits until the base is free"
            return True
        self._send(name, kind, state, now)
        return True

    def _send(self, object_id: str, class_name: str, state: WorldState, now: float) -> None:
        """Have an object searched for; by its class alone where it is the only one of it."""
        others = any(
            item.id != object_id and not item.lost and item.most_probable("class") == class_name
            for item in state.objects
        )
        self._searching, self._not_before, run = object_id, now + AGAIN, self._run
        self.said = f"{object_id} is lost: it is searched for"
        self.sent += 1
        goal = FindObject.Goal(
            class_name=class_name, object_id=object_id if others else "", timeout=duration_message(LONGEST)
        )

        def ended(answer: Any) -> None:
            if run == self._run:
                self._ended(object_id, answer)

        self._caller.send(goal, ended)

    def _ended(self, object_id: str, answer: Any) -> None:
        self._searching = ""
        # Refused as the node is not active, or ended by somebody who goes first: once more, when the base is free.
        if answer is not None and answer.result.code != FindObject.Result.CANCELED:
            self._waiting.pop(object_id, None)


class BaseClaim:
    """The node's word on `base_available`. What others said before holds again when it gives the base back.

    taken_by_others : whether somebody else than this node has said last that the base is not to be moved.
    """

    def __init__(self, node: SuiteNode) -> None:
        self._output = node.add_output(Bool, "base_available", LATCHED)
        node.add_latched_input(Bool, "base_available", self._take)
        self._own: list[bool] = []  # what this node has said and not heard yet
        self._held = False
        self.taken_by_others = False

    def take(self) -> None:
        """The base is moved by this node from now on."""
        self._held = True
        self._say(False)

    def give_back(self) -> None:
        """This node moves it no longer."""
        self._held = False
        self._say(not self.taken_by_others)

    def _say(self, available: bool) -> None:
        before = self._output.count
        self._output.publish(Bool(data=available))
        if self._output.count > before:  # else the node is inactive, and nobody hears it
            self._own.append(available)

    def _take(self, message: Bool, _stamp: int) -> None:
        available = bool(message.data)
        # It hears itself, too. Whose of two equal words is heard first makes no difference.
        if self._own and self._own[0] == available:
            self._own.pop(0)
            return
        self.taken_by_others = not available
        if self._held and available:
            self._say(False)
