"""What `world_model` publishes: the world, its hypotheses, objects for others' tools, and markers."""

from __future__ import annotations

import numpy as np
from std_msgs.msg import Header
from vision_msgs.msg import Detection3DArray
from visualization_msgs.msg import MarkerArray

from whereabouts.nodes.messages.stamps import NANOSECONDS, time_message
from whereabouts.nodes.messages.world_messages import (
    ObjectMessages,
    by_id,
    detections_message,
    hypotheses_message,
    marker_messages,
    state_message,
)
from whereabouts.nodes.ros.base import SuiteNode
from whereabouts.nodes.ros.qos import HEARD_LATCHED
from whereabouts_msgs.msg import WorldHypotheses
from whereabouts_msgs.msg import WorldState as StateMessage
from world_model import WorldModel, WorldObject, WorldState

# Of the messages with hypotheses: s between two, and how many are in one.
HYPOTHESES_PERIOD, PUBLISHED = 0.2, 20


class WorldPublisher:
    """Outputs in the world's frame; all but the state only for listeners.

    shown : objects that were published last. stamp : of these, ns.
    """

    def __init__(self, node: SuiteNode, map_frame: str, model: WorldModel) -> None:
        self.map_frame, self.model = map_frame, model
        self._messages = ObjectMessages(model.words)
        self.shown: list[WorldObject] = []
        self._state = node.add_output(StateMessage, "world_state", HEARD_LATCHED)
        self._hypotheses = node.add_output(WorldHypotheses, "world_hypotheses")
        self._objects = node.add_output(Detection3DArray, "objects")
        self._markers = node.add_output(MarkerArray, "~/markers")
        self.begin()

    def begin(self) -> None:
        """A new run: hypotheses are due."""
        self._hypotheses_at: int | None = None
        self.stamp = 0

    def send(self, state: WorldState, stamp: int) -> None:
        """Publish a state of the model, at a stamp, ns, or at its own if that is later."""
        self.stamp = stamp = stamp if state.stamp <= stamp / NANOSECONDS else round(state.stamp * NANOSECONDS)
        self.shown = by_id(state.objects)
        header = Header(stamp=time_message(max(stamp, 0)), frame_id=self.map_frame)
        objects = [self._messages.message(item) for item in self.shown]
        self._state.publish(state_message(state, header, objects))
        if self._objects.wanted:
            self._objects.publish(detections_message(header, objects))
        if self._markers.wanted:
            self._markers.publish(marker_messages(header, self.shown, self.model.words))
        kept = list(state.objects)
        if self._hypotheses.wanted and self._is_time_for_hypotheses(stamp):
            hypotheses = self.model.hypotheses()[:PUBLISHED]
            self._hypotheses.publish(hypotheses_message(hypotheses, header, self._messages))
        self._messages.keep(kept)
        self.model.words.keep(kept)

    def now_known(self) -> WorldState:
        if not np.isfinite(self.model.stamp):
            return WorldState((), 1.0, 0.0, 0.0, self.model.epoch)
        return self.model.world

    def after_change(self) -> None:
        """Somebody has corrected the world: say how it is now."""
        self.send(self.now_known(), self.stamp)

    def _is_time_for_hypotheses(self, stamp: int) -> bool:
        since = None if self._hypotheses_at is None else (stamp - self._hypotheses_at) / NANOSECONDS
        if since is not None and 0.0 <= since < HYPOTHESES_PERIOD:
            return False
        self._hypotheses_at = stamp
        return True
