"""The bond with nav2's lifecycle manager, where the package bondpy is installed: either learns when the other dies."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from whereabouts.nodes.ros.base import SuiteNode

# As nav2's own nodes: topic, s between heartbeats, s without one after which the other counts as dead.
TOPIC, PERIOD, TIMEOUT = "bond", 0.1, 4.0


class Bonding:
    """A bond while the node is active. Nobody bonds with a node that activates itself, or in a replay."""

    def __init__(self, node: SuiteNode) -> None:
        self._node = node
        self._bond: Any = None

    def form(self) -> None:
        self.end()
        if self._node.settings.autostart or self._node.replayed:
            return
        try:
            kind = import_module("bondpy.bondpy").Bond
        except ImportError:
            return
        self._bond = kind(self._node, TOPIC, self._node.get_name())
        self._bond.set_heartbeat_period(PERIOD)
        self._bond.set_heartbeat_timeout(TIMEOUT)
        self._bond.start()

    def end(self) -> None:
        """Tell the other side that this is on purpose."""
        bond, self._bond = self._bond, None
        if bond is not None:
            bond.shutdown()
