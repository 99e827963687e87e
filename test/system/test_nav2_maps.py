"""The map by nav2's names, asked for as nav2's tools and tutorials do."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import pytest
from harness import Graph
from nav_msgs.srv import GetMap
from std_srvs.srv import Empty
from test_loop_closure import Mapper

from estimation.errors import InputError
from estimation.geometry.grid import OccupancyGrid
from estimation.geometry.poses import between
from whereabouts.nodes.navigation.nav2_maps import file_of

services = pytest.importorskip("nav2_msgs.srv")
SaveMap, LoadMap = services.SaveMap, services.LoadMap


def request(url: str, **fields: object) -> Any:
    """As in nav2's documentation."""
    made = SaveMap.Request(
        map_topic="map", map_url=url, image_format="pgm", map_mode="trinary", free_thresh=0.25,
        occupied_thresh=0.65,
    )  # fmt: skip
    for name, value in fields.items():
        setattr(made, name, value)
    return made


def test_urls_are_paths_or_files() -> None:
    assert file_of("home") == "home"
    assert file_of("file:///tmp/my%20map.yaml") == "/tmp/my map.yaml"
    for url in ("package://robot/maps/home.yaml", "http://robot/home.yaml", "file://home.yaml"):
        with pytest.raises(InputError, match="map_url"):
            file_of(url)


def test_a_map_is_saved_and_loaded_by_nav2s_names_and_nothing_foreign_is_touched(
    graph: Graph, tmp_path: Path
) -> None:
    robot, folder, state = Mapper(graph), tmp_path / "my maps", tmp_path / "state"
    folder.mkdir()
    graph.start("scan_registration")
    spec = graph.start("loop_closure", allowed_folders=[str(folder)], state_dir=str(state))
    graph.mount()

    def saved(asked: Any) -> bool:
        return bool(graph.call(SaveMap, "map_saver/save_map", asked).result)

    def loaded(url: str) -> Any:
        return graph.call(LoadMap, "map_server/load_map", LoadMap.Request(map_url=url))

    assert not saved(request(str(folder / "early"))), "there is no map yet"
    robot.introduce()
    robot.go(0.0, 3.0, 0.25)
    stem = folder / "home"
    assert saved(request(str(stem))), graph.log(spec)
    assert {path.name for path in folder.iterdir()} == {"home.npz", "home.pgm", "home.yaml"}
    assert saved(SaveMap.Request(map_url="office")), "nothing but a name, which is one in the state directory"
    assert (state / "office.yaml").exists()

    # What cannot be written as asked is not written otherwise.
    (folder / "mine.yaml").write_text("port: 22")
    refused = (
        request(str(folder / "mine")), request("/etc/ring"), request(f"{folder}/../ring"),
        request("package://robot/ring"), request(str(stem), map_topic="/costmap"),
        request(str(stem), image_format="png"), request(str(stem), map_mode="scale"),
        request(str(stem), free_thresh=0.7),
    )  # fmt: skip
    for asked in refused:
        assert not saved(asked), asked
    assert (folder / "mine.yaml").read_text() == "port: 22"
    for reason in (
        "was not overwritten",
        "allowed_folders",
        "map_url",
        "map_topic",
        "image_format",
        "map_mode",
    ):
        assert reason in graph.log(spec), reason
    drawn = stem.with_suffix(".pgm").read_bytes().replace(b"# whereabouts", b"# Created by")
    stem.with_suffix(".pgm").write_bytes(drawn)
    assert not saved(request(str(stem))), "somebody has drawn in the image"
    assert stem.with_suffix(".pgm").read_bytes() == drawn

    # Read again, as map_server is asked to; the answer has the map.
    answer = loaded("file://" + quote(f"{stem}.yaml"))
    assert answer.result == LoadMap.Response.RESULT_SUCCESS, graph.log(spec)
    read = OccupancyGrid.load(folder / "home.yaml")
    values = np.array(answer.map.data, dtype=np.int8).reshape(answer.map.info.height, answer.map.info.width)
    assert (values == 100).sum() == pytest.approx(read.occupied.sum(), rel=0.05)
    asked_for = graph.call(GetMap, "map_server/map", GetMap.Request()).map
    assert (asked_for.header.frame_id, asked_for.data) == ("map", answer.map.data)
    assert loaded(str(folder / "none.yaml")).result == LoadMap.Response.RESULT_MAP_DOES_NOT_EXIST
    assert loaded(str(folder / "mine.yaml")).result == LoadMap.Response.RESULT_INVALID_MAP_DATA
    (folder / "broken.npz").write_bytes(b"no map")
    assert loaded(str(folder / "broken")).result == LoadMap.Response.RESULT_INVALID_MAP_DATA
    # Looked for anew, as amcl is asked to, the robot is found again.
    robot.transforms.clear()
    robot.go(3.0, 7.0, 0.25)
    graph.until(robot.in_map, "the robot is found")
    graph.call(Empty, "reinitialize_global_localization", Empty.Request())
    robot.transforms.clear()
    robot.go(7.0, 12.0, 0.25)
    pose = graph.until(robot.in_map, "the robot is found again")[0]
    miss = between(robot.truth(11.75), pose)
    assert np.hypot(*miss[:2]) < 0.25
    assert graph.log(spec).count("the robot was found in the map") == 2
    assert loaded("/etc/ring.yaml").result == LoadMap.Response.RESULT_UNDEFINED_FAILURE
    assert "defect" not in graph.log(spec)
