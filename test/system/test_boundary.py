"""What a node lets in: nothing outside of its envelope, no more than its budget, and no exception out."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
from harness import START, Graph, mounting, scan_message
from lifecycle_msgs.msg import State
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Bool
from test_faults import figures
from tf2_msgs.msg import TFMessage

from estimation.errors import InputError
from registration import Scan
from whereabouts.node_interfaces import NODE_INTERFACES
from whereabouts.nodes.messages.conversions import stated_covariance
from whereabouts.nodes.messages.envelopes import envelope
from whereabouts.nodes.messages.message_types import message_class
from whereabouts.nodes.messages.packed import Packed
from whereabouts.nodes.messages.stamps import NANOSECONDS, time_message
from whereabouts.nodes.ros.base import SuiteNode, start
from whereabouts.nodes.ros.executor import NodeExecutor
from whereabouts.nodes.ros.input_counts import BURST, Budget, Purse
from whereabouts.nodes.ros.qos import HEARD_LATCHED, LATCHED, TF_STATIC_QOS
from whereabouts.nodes.verifier_node import VerifierNode
from whereabouts_msgs.msg import DiscreteDistribution, ObjectEvidence, WorldEvidence, WorldObject, WorldState

HERE = (0.0, 0.0, 0.2, 0.0, 0.0, 0.0, 1.0)
INPUTS = sorted({item.type for items in NODE_INTERFACES.values() for item in items if item.kind == "in"})


def located(kind: Any = PoseWithCovarianceStamped, **entries: float) -> Any:
    """A message of a pose with entries of its covariance, such as c01."""
    covariance = np.diag(np.full(6, 0.01))
    for name, value in entries.items():
        covariance[int(name[1]), int(name[2])] = value
    message = kind()
    message.pose.covariance = covariance.ravel()
    return message


def far(x: float) -> WorldState:
    item = WorldObject(id="cup-1")
    item.pose.pose.position.x = x
    return WorldState(objects=[WorldObject(id="bowl-1"), item])


@pytest.mark.parametrize("kind", INPUTS)
def test_an_empty_message_of_every_input_is_inside(kind: str) -> None:
    found = message_class(kind.replace("/", "/msg/"))
    message = found()
    if found is OccupancyGrid:
        message.info.resolution = 0.05
    envelope(found).check(message)


@pytest.mark.parametrize(
    ("message", "place"),
    [
        (far(1.1e6), r"objects\[1\] \(cup-1\).pose.pose.position.x"),
        (far(float("nan")), r"objects\[1\] \(cup-1\).pose.pose.position.x"),
        (located(c00=float("nan")), "pose.covariance"),
        (located(c01=0.005), "pose.covariance: a symmetric"),
        (located(c01=0.02, c10=0.02), "pose.covariance: a covariance without negative eigenvalues"),
        (located(c00=-1.0), "pose.covariance: a covariance without negative eigenvalues"),
        (LaserScan(angle_increment=float("inf")), "angle_increment"),
        (LaserScan(ranges=[1.0] * 1_000_001), "ranges: .* elements"),
        (OccupancyGrid(), "info.resolution"),
        (WorldEvidence(sensor="a\nb"), "sensor: printable"),
        (WorldEvidence(sensor="x" * 5000), "sensor: at most"),
        (DiscreteDistribution(values=["cup"], probabilities=[1.5]), "probabilities"),
        (TFMessage(transforms=[TransformStamped()] * 1001), "transforms: .* elements"),
    ],
)
def test_what_is_outside_is_refused_by_its_place(message: Any, place: str) -> None:
    with pytest.raises(InputError, match=place):
        envelope(type(message)).check(message)


@pytest.mark.parametrize("entries", [{"c00": -1.0}, {"c00": float("nan")}, {"c01": 0.5}, {"c33": 1e30}])
def test_a_base_that_does_not_know_its_covariance_still_tells_where_it_is(entries: dict[str, float]) -> None:
    message = located(Odometry, **entries)
    message.twist.covariance = message.pose.covariance
    envelope(Odometry).check(message)
    assert stated_covariance(message.pose.covariance) is None
    message.pose.pose.position.x = float("nan")
    with pytest.raises(InputError, match=r"pose\.pose\.position\.x"):
        envelope(Odometry).check(message)


def test_unknown_covariances_and_missing_returns_are_inside() -> None:
    envelope(Odometry).check(Odometry())
    ranges = [float("nan"), float("inf"), 1.0, 0.0]
    envelope(LaserScan).check(LaserScan(ranges=ranges, range_max=float("inf"), time_increment=float("nan")))
    # Only the world model reads what a detector scored; it may be of an independent classifier.
    envelope(WorldEvidence).check(WorldEvidence(objects=[ObjectEvidence()] * 10_000))


def test_bytes_that_are_no_message_are_refused_and_nothing_else_is_raised() -> None:
    rng = np.random.default_rng(5)
    whole = serialize_message(far(1.0))
    outcomes = set()
    for _ in range(3000):
        data = bytearray(whole)
        for at in rng.integers(0, len(data), 3):
            data[at] = rng.integers(256)
        given = bytes(data[: rng.integers(len(data) + 1)] if rng.random() < 0.5 else data)
        try:
            Packed(WorldState, given).unpack()
        except InputError:
            outcomes.add("refused")
        else:
            outcomes.add("read")
    assert outcomes == {"refused", "read"}


@pytest.mark.parametrize("name", ["world_maintenance", "object_search"])
def test_samples_too_short_for_a_stamp_end_no_node(graph: Graph, name: str) -> None:
    diagnostics = graph.collect(DiagnosticArray, "/diagnostics")
    spec = graph.start(name)
    broken = [bytes([0, 1, 0, 0]) + bytes(length) for length in range(8)]
    for data in broken:
        graph.publish("world_state", data, HEARD_LATCHED, kind=WorldState)
    dropped = "/world_state dropped, refused"
    graph.until(lambda: figures(name, diagnostics).get(dropped) == str(len(broken)), "all are counted")
    assert graph.state(spec) == State.PRIMARY_STATE_ACTIVE


def test_a_transform_of_1e19_metres_ends_no_node(graph: Graph) -> None:
    diagnostics = graph.collect(DiagnosticArray, "/diagnostics")
    spec = graph.start("loop_closure")
    graph.publish("tf_static", TFMessage(transforms=[mounting("laser", HERE)]), TF_STATIC_QOS)
    ranges = np.full(181, 2.0)
    for k, x in enumerate((0.0, 1e19, 0.5e6, 0.0)):
        link = mounting("base_link", (x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))
        link.header.frame_id, link.header.stamp = "odom", time_message(START + k * NANOSECONDS // 10)
        graph.publish("tf", TFMessage(transforms=[link]))
        message = scan_message(Scan(ranges, -np.pi / 2, np.pi / 180, 0.05, 30.0))
        message.header.stamp = link.header.stamp
        graph.publish("scan", message)
    dropped = "/tf dropped, refused"
    graph.until(lambda: figures("loop_closure", diagnostics).get(dropped) == "1", "it is counted")
    graph.until(lambda: int(figures("loop_closure", diagnostics).get("/scan used", 0)) >= 3, "scans are used")
    assert graph.state(spec) == State.PRIMARY_STATE_ACTIVE


class Careless(VerifierNode):
    """Whatever it does raises."""

    def setup(self) -> None:
        super().setup()
        self.add_latched_input(Bool, "raises", self._raise)
        self.created.callback(self.destroy_timer, self.create_timer(0.01, self._raise))

    def _raise(self, *_: Any) -> None:
        raise ZeroDivisionError("careless")

    def health(self) -> Any:
        raise ZeroDivisionError("careless")


@pytest.fixture
def in_process(graph: Graph) -> Iterator[Callable[..., SuiteNode]]:
    """Maker of active nodes in this process."""
    made: list[SuiteNode] = []

    def make(kind: type[SuiteNode], **parameters: Any) -> SuiteNode:
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        made.append(kind(context=graph.context, parameter_overrides=overrides))
        assert start(made[-1])
        return made[-1]

    yield make
    for node in made:
        node.destroy_node()


def test_no_exception_leaves_a_callback(
    graph: Graph, in_process: Callable[..., SuiteNode], monkeypatch: pytest.MonkeyPatch
) -> None:
    node = in_process(Careless, diagnostics_period=0.1)
    executor = NodeExecutor(graph.context)
    executor.add_node(node)
    said: set[str] = set()
    report = node.report_defect

    def note(where: str, error: Exception) -> None:
        said.add(where)
        report(where, error)

    monkeypatch.setattr(node, "report_defect", note)

    async def raises() -> None:
        raise ZeroDivisionError("careless")

    executor.create_task(raises())
    graph.publish("raises", Bool(), LATCHED)
    item = next(item for item in node.inputs if item.topic == "/raises")
    while not ({"timer", "task", "health"} <= said and item.counts.drops["internal error"]):
        executor.spin_once(timeout_sec=0.05)
        graph.executor.spin_once(timeout_sec=0.0)
    assert node.complaints.defects >= 4


def test_a_budget_is_spent_and_paid_back() -> None:
    purse = Purse(Budget(messages=10.0, bytes=1000.0, share=0.5))
    for _ in range(round(BURST * 10.0)):
        assert not purse.over(1.0)
        purse.spend(1, 0.0)
    assert "messages" in purse.over(1.0)
    assert not purse.over(1.2)
    purse.spend(5000, 0.0)
    assert "bytes" in purse.over(1.3)
    assert "bytes" in purse.over(2.2)
    assert not purse.over(2.4)
    # One message that took for ever does not silence an input for as long.
    purse.spend(1, 1000.0)
    assert "handling" in purse.over(3.0)
    assert not purse.over(2.4 + 1.1)


def test_beyond_its_budget_an_input_keeps_the_newest(
    graph: Graph, in_process: Callable[..., SuiteNode], monkeypatch: pytest.MonkeyPatch
) -> None:
    node = in_process(VerifierNode)
    item = next(item for item in node.inputs if item.topic == "/map")
    used: list[float] = []
    monkeypatch.setattr(item, "_handler", lambda message, stamp: used.append(message.info.origin.position.x))
    over = [""]
    monkeypatch.setattr(item._purse, "over", lambda now: over[0])

    def send(x: float) -> None:
        grid = OccupancyGrid()
        grid.info.resolution, grid.info.origin.position.x = 0.05, x
        item._receive(grid, {})

    send(0.0)
    over[0] = "too much"
    for x in (1.0, 2.0, 3.0):
        send(x)
    item.serve_shed()
    assert used == [0.0]
    over[0] = ""
    item.serve_shed()
    assert used == [0.0, 3.0]
    assert item.counts.drops == {"over budget": 2}
    assert (item.counts.received, item.counts.used, item.counts.dropped) == (4, 2, 2)


def test_in_lock_step_nothing_is_shed(
    graph: Graph, in_process: Callable[..., SuiteNode], monkeypatch: pytest.MonkeyPatch
) -> None:
    node = in_process(VerifierNode, report_processed=True)
    item = next(item for item in node.inputs if item.topic == "/map")
    monkeypatch.setattr(item._purse, "over", lambda now: "too much")
    grid = OccupancyGrid()
    grid.info.resolution = 0.05
    for _ in range(5):
        item._receive(grid, {})
    assert item.counts.used == 5
