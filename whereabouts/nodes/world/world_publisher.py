"""What `world_model` publishes: the world, its hypotheses, objects for others' tools, and markers."""

from __future__ import annotations

from collections.abc import Sequence

from std_msgs.msg import Header
from vision_msgs.msg import Detection3DArray
from visualization_msgs.msg import MarkerArray

from whereabouts.nodes.messages.stamps import NANOSECONDS, time_message
from whereabouts.nodes.messages.world_messages import (
    ObjectMessages,
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
from world_model.queries import Words

# Of the messages with hypotheses: s between two, and how many are in one.
HYPOTHESES_PERIOD, PUBLISHED = 0.2, 20


class WorldPublisher:
    """Outputs in the world's frame; all but the state only for listeners."""

    def __init__(self, node: SuiteNode, map_frame: str, words: Words) -> None:
        self._map, self._words = map_frame, words
        self._messages = ObjectMessages(words)
        self._state = node.add_output(StateMessage, "world_state", HEARD_LATCHED)
        self._hypotheses = node.add_output(WorldHypotheses, "world_hypotheses")
        self._objects = node.add_output(Detection3DArray, "objects")
        self._markers = node.add_output(MarkerArray, "~/markers")
        self.begin()

    def begin(self) -> None:
        """A new run: hypotheses are due."""
        self._hypotheses_at: int | None = None

    def send(self, state: WorldState, shown: Sequence[WorldObject], stamp: int, model: WorldModel) -> None:
        """Publish a state of the model; shown : its objects in order. stamp : ns."""
        header = self.header(stamp)
        objects = [self._messages.message(item) for item in shown]
        self._state.publish(state_message(state, header, objects))
        if self._objects.wanted:
            self._objects.publish(detections_message(header, objects))
        if self._markers.wanted:
            self._markers.publish(marker_messages(header, shown, self._words))
        kept = list(state.objects)
        if self._hypotheses.wanted and self._is_time_for_hypotheses(stamp):
            hypotheses = model.hypotheses()[:PUBLISHED]
            self._hypotheses.publish(hypotheses_message(hypotheses, header, self._messages))
        self._messages.keep(kept)
        self._words.keep(kept)

    def header(self, stamp: int) -> Header:
        """Of a message in the world's frame."""
        return Header(stamp=time_message(max(stamp, 0)), frame_id=self._map)

    def _is_time_for_hypotheses(self, stamp: int) -> bool:
        since = None if self._hypotheses_at is None else (stamp - self._hypotheses_at) / NANOSECONDS
        if since is not None and 0.0 <= since < HYPOTHESES_PERIOD:
            return False
        self._hypotheses_at = stamp
        return True
