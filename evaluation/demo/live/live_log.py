"""A simulated day as messages that are made as they are sent, so that the robot may drive where the nodes tell it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from whereabouts.logs import McapWriter, Qos, RawMessage, Topic
from whereabouts.messages.type_names import EVIDENCE
from whereabouts.simulation.home.apartment_bag import MomentWriter
from whereabouts.simulation.home.live_apartment import LiveDay

LATCHED = Qos(depth=1, durability="transient_local")
TOPICS = (
    Topic("/tf_static", "tf2_msgs/msg/TFMessage", qos=(LATCHED,)),
    Topic("/tf", "tf2_msgs/msg/TFMessage"),
    Topic("/wheel_odom", "nav_msgs/msg/Odometry"),
    Topic("/scan", "sensor_msgs/msg/LaserScan"),
    Topic("/points", "sensor_msgs/msg/PointCloud2"),
    Topic("/evidence", EVIDENCE),
)


class _Kept(McapWriter):
    """Writes a bag and keeps what is new."""

    def __init__(self, target: Path) -> None:
        super().__init__(target)
        self.fresh: list[RawMessage] = []

    def write_raw(self, topic: Topic, data: bytes, log_time: int) -> None:
        super().write_raw(topic, data, log_time)
        self.fresh.append(RawMessage(topic, data, log_time))


class LiveLog:
    """Moments of a day as a log that is written to `bag` as it is read, the truth with it.

    go_on : called before each moment; the log ends where it answers False. longest : s after which it ends anyway.
    """

    def __init__(self, day: LiveDay, bag: Path, go_on: Callable[[], bool], longest: float) -> None:
        self._day, self._bag, self._go_on, self._longest = day, bag, go_on, longest

    @property
    def topics(self) -> list[Topic]:
        """What the robot's drivers publish."""
        return list(TOPICS)

    @property
    def progress(self) -> float:
        """Share of the longest time that has passed."""
        return min(self._day.time / self._longest, 1.0)

    def __iter__(self) -> Iterator[RawMessage]:
        names = {topic.name for topic in TOPICS}
        writer = _Kept(self._bag)
        with writer:
            recorder = MomentWriter(writer)
            while self._day.time < self._longest and self._go_on():
                recorder.write(self._day.step())
                fresh, writer.fresh = writer.fresh, []
                yield from (message for message in fresh if message.name in names)

    def close(self) -> None:
        """Nothing is kept open between two passes."""
