"""Who moves the base, as `object_search` says it on `base_available` and hears it from others."""

from __future__ import annotations

from std_msgs.msg import Bool

from whereabouts.nodes.ros.base import SuiteNode
from whereabouts.nodes.ros.qos import LATCHED


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
