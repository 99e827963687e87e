"""People as a mask for nav2's costmaps: taken as KeepoutFilter takes it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from harness import Graph
from nav_msgs.msg import MapMetaData, OccupancyGrid
from test_motion_predictor import NODE, People, teach

from tracking.intentions import Prediction
from tracking.intentions.prediction import PredictedWay
from whereabouts.nodes.messages.intention_messages import PathMarkers
from whereabouts.nodes.navigation.keepout_mask import mask_values
from whereabouts.nodes.ros.qos import LATCHED

CostmapFilterInfo = pytest.importorskip("nav2_msgs.msg").CostmapFilterInfo
UNKNOWN, LETHAL = 255, 254


def prediction(shares: list[float], speed: float = 1.0) -> Prediction:
    """From (1, 1) along x, and by the other goals along y and so on, a metre a second."""
    times = np.arange(0.0, 6.0, 0.5)
    turns = np.pi / 2 * np.arange(len(shares))
    paths = [
        np.column_stack((1.0 + speed * times * np.cos(turn), 1.0 + speed * times * np.sin(turn), times))
        for turn in turns
    ]
    covariances = np.tile(np.eye(2), (len(times), 1, 1))
    goals = np.array([path[-1, :2] for path in paths])
    others = [PredictedWay(k, path, covariances) for k, path in enumerate(paths) if k]
    return Prediction(goals, np.array(shares), paths[0], covariances, others, 0.0)


def metadata(width: int, height: int, x: float, y: float, turn: float = 0.0) -> MapMetaData:
    info = MapMetaData(width=width, height=height, resolution=0.1)
    info.origin.position.x, info.origin.position.y = x, y
    info.origin.orientation.z, info.origin.orientation.w = float(np.sin(turn / 2)), float(np.cos(turn / 2))
    return info


@pytest.mark.parametrize("turn", [0.0, 0.4])
def test_a_cell_has_the_probability_of_the_ways_that_pass_it(turn: float) -> None:
    told, info = prediction([0.6, 0.3, 0.1]), metadata(50, 40, -0.5, -0.3, turn)
    ways = PathMarkers(horizon=2.0, interval=0.25, least=0.2)
    values = mask_values({1: told}, 0.0, info, ways, radius=0.35)
    c, s = np.cos(turn), np.sin(turn)
    # Cell by cell, from what is meant: the third way is too improbable to count.
    for row in range(info.height):
        for column in range(info.width):
            along, up = 0.1 * (column + 0.5), 0.1 * (row + 0.5)
            at = np.array([-0.5 + c * along - s * up, -0.3 + s * along + c * up])
            away = [
                np.array([np.hypot(*(at - 1.0 - step * direction)) for step in np.arange(0.0, 2.01, 0.25)])
                for direction in (np.array([1.0, 0.0]), np.array([0.0, 1.0]))
            ]
            if min(abs(away[0] - 0.35).min(), abs(away[1] - 0.35).min()) < 1e-6:
                continue
            passes = [bool((distances < 0.35).any()) for distances in away]
            expected = 100 if away[0][0] < 0.35 else round(100 * (0.6 * passes[0] + 0.3 * passes[1])) or -1
            assert values[row, column] == expected, (row, column)
    assert set(np.unique(values)) == {-1, 30, 60, 90, 100} & set(np.unique(values))
    assert {-1, 60, 100} <= set(np.unique(values))


def test_people_outside_the_map_and_two_at_a_place() -> None:
    ways = PathMarkers(1.0, 0.25, 0.2)
    far = mask_values({1: prediction([1.0])}, 0.0, metadata(10, 10, 100.0, 100.0), ways, 0.3)
    assert (far == -1).all()
    both = mask_values(
        {1: prediction([1.0]), 2: prediction([0.5, 0.5])}, 0.0, metadata(50, 50, -1.0, -1.0), ways, 0.3
    )
    alone = mask_values({1: prediction([1.0])}, 0.0, metadata(50, 50, -1.0, -1.0), ways, 0.3)
    assert (both >= alone).all()
    assert (both == 50).any()


class KeepoutFilter:
    """nav2's: hears of the mask by a topic, and lays it over a costmap (H, W) with the mask's cells."""

    def __init__(self, graph: Graph) -> None:
        self.infos: list[Any] = graph.collect(CostmapFilterInfo, "/people_filter_info", LATCHED)
        self.masks: list[OccupancyGrid] = []
        self._graph = graph

    def listen(self) -> None:
        info = self._graph.until(lambda: self.infos, "filter info")[-1]
        assert (info.type, info.base, info.multiplier) == (0, 0.0, 1.0)
        assert info.filter_mask_topic.startswith("/"), "it is looked for from the costmap's namespace"
        self.masks = self._graph.collect(OccupancyGrid, info.filter_mask_topic, LATCHED)

    def over(self, costmap: np.ndarray, mask: OccupancyGrid) -> np.ndarray:
        """The costmap with a mask."""
        made = costmap.copy().ravel()
        for index, value in enumerate(mask.data):
            cost = UNKNOWN if value == -1 else round(value * LETHAL / 100)
            if cost != UNKNOWN and (cost > made[index] or made[index] == UNKNOWN):
                made[index] = cost
        return made.reshape(costmap.shape)

    def until(self, ready: Callable[[OccupancyGrid], bool], what: str) -> OccupancyGrid:
        return self._graph.until(lambda: next(filter(ready, reversed(self.masks)), None), what)


def test_a_keepout_filter_keeps_clear_of_where_people_will_be(graph: Graph) -> None:
    people = People(graph)
    graph.start(NODE, publish_mask=True, mask_radius=0.4)
    grid = OccupancyGrid()
    grid.header.frame_id = "map"
    grid.info = metadata(120, 100, -1.0, -2.0)
    grid.data = [0] * 12000
    graph.publish("map", grid, LATCHED)
    keepout = KeepoutFilter(graph)
    keepout.listen()
    teach(people)
    people.walk("up", until=3.0)
    place = (int((3.5 + 1.0) / 0.1), int((0.0 + 2.0) / 0.1))  # after 2.8 s at 1.2 m/s
    mask = keepout.until(lambda mask: mask.data[120 * place[1] + place[0]] == 100, "somebody is there")
    assert mask.header.frame_id == "map"
    assert (mask.info.width, mask.info.height, mask.info.origin) == (120, 100, grid.info.origin)
    assert mask.info.resolution == pytest.approx(0.1)
    costmap = np.full((100, 120), UNKNOWN, dtype=np.int64)
    costmap[:, :60] = 0
    laid = keepout.over(costmap, mask)
    assert laid[place[1], place[0]] == LETHAL
    assert (laid[:10] == costmap[:10]).all(), "what is far from people stays as it was, unknown, too"
    keepout.until(lambda mask: any(0 < value < 100 for value in mask.data), "less probable ways cost less")
    # Who has gone, and a tracker that says nothing any more, leave nothing behind.
    graph.until(lambda: set(keepout.masks[-1].data) == {-1}, "nobody is drawn without news")
