"""The interface packages that are built into the environment."""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path

import pytest
from rosbags.typesys import get_types_from_msg
from vision_msgs.msg import Detection3DArray, ObjectHypothesisWithPose

from whereabouts.logs.bags.ros_types import standard_types
from whereabouts.nodes.messages.message_types import UnknownTypeError, definition, message_class
from whereabouts_msgs.action import FindObject, VerifyObject
from whereabouts_msgs.msg import WorldState
from whereabouts_msgs.srv import (
    ForgetObject,
    LoadMap,
    LoadState,
    QueryWorld,
    RelabelObject,
    Reset,
    SaveMap,
    SaveState,
    TriggerVerification,
)

# RIHS01 hashes of the types in the ROS packages' own generated code.
PUBLISHED = {
    "vision_msgs/msg/LabelInfo": "3d37df4015cdf660cc851c51897f2acd957e1ca6205ba0a99aebffb9406b0783",
    "vision_msgs/msg/VisionClass": "1e4a11f0fed50b5623cb8ff26ca0e37952a48a9c074d16f804b44e9164c2037a",
    "vision_msgs/msg/VisionInfo": "95d3116a17484ad91c9a2686e1d54890bbfc3ff6c6a2de137738c4950d45d284",
    "vision_msgs/msg/BoundingBox3D": "bbb73a65c163d7f9bb29009c7bde9f7faa576bd2d23299c4511d19230dab4698",
    "vision_msgs/msg/ObjectHypothesis": "51da43cec11c01957a64d1e05a24acd18aae7745ec30b74348ad5f6d634f7f90",
    "vision_msgs/msg/Detection2DArray": "214274120007f4a683866481336b70310268cfa107aebe9d594a6acf75bda968",
    "vision_msgs/msg/Detection3DArray": "793f5eab9595ac1c0da07873cc859db42eae51f0ee76056db8562515d830e018",
}


def built_hash(type_name: str) -> str:
    package, kind, name = type_name.split("/")
    described = json.loads((Path(sys.prefix) / "share" / package / kind / f"{name}.json").read_text())
    return next(item["hash_string"] for item in described["type_hashes"] if item["type_name"] == type_name)


@pytest.mark.parametrize("type_name", PUBLISHED)
def test_vision_messages_have_the_hashes_of_the_ros_package(type_name: str) -> None:
    assert built_hash(type_name) == f"RIHS01_{PUBLISHED[type_name]}"


@pytest.mark.parametrize("name", ["TFMessage", "TF2Error"])
def test_tf_messages_have_the_hashes_of_the_ros_package(name: str) -> None:
    type_name = f"tf2_msgs/msg/{name}"
    assert built_hash(type_name) == standard_types().hash_rihs01(type_name)


def test_map_updates_have_the_hash_of_the_ros_package_s_fields() -> None:
    """As rosbags computes it; its name and fields are those of map_msgs."""
    name = "map_msgs/msg/OccupancyGridUpdate"
    fields = "std_msgs/Header header\nint32 x\nint32 y\nuint32 width\nuint32 height\nint8[] data"
    types = standard_types()
    types.register(get_types_from_msg(fields, name))
    assert built_hash(name) == types.hash_rihs01(name)


# Jazzy's, as ROS packages of nav2_msgs 1.3 have them: nodes hear each other only where all fields are the same.
NAV2_FIELDS = {
    "action.NavigateToPose.Goal": {"pose": "geometry_msgs/PoseStamped", "behavior_tree": "string"},
    "action.NavigateToPose.Result": {"error_code": "uint16", "error_msg": "string"},
    "action.NavigateToPose.Feedback": {
        "current_pose": "geometry_msgs/PoseStamped", "navigation_time": "builtin_interfaces/Duration",
        "estimated_time_remaining": "builtin_interfaces/Duration", "number_of_recoveries": "int16",
        "distance_remaining": "float",
    },
    "srv.SaveMap.Request": {
        "map_topic": "string", "map_url": "string", "image_format": "string", "map_mode": "string",
        "free_thresh": "float", "occupied_thresh": "float",
    },
    "srv.SaveMap.Response": {"result": "boolean"},
    "srv.LoadMap.Request": {"map_url": "string"},
    "srv.LoadMap.Response": {"map": "nav_msgs/OccupancyGrid", "result": "uint8"},
    "msg.CostmapFilterInfo": {
        "header": "std_msgs/Header", "type": "uint8", "filter_mask_topic": "string", "base": "float",
        "multiplier": "float",
    },
}  # fmt: skip


@pytest.mark.parametrize("name", NAV2_FIELDS)
def test_nav2_types_have_the_fields_of_jazzy(name: str) -> None:
    kind, *parts = name.split(".")
    found = importlib.import_module(f"nav2_msgs.{kind}")
    for part in parts:
        found = getattr(found, part)
    assert list(found.get_fields_and_field_types().items()) == list(NAV2_FIELDS[name].items())


def test_every_service_answers_with_a_code_and_a_sentence() -> None:
    services = (
        QueryWorld,
        TriggerVerification,
        ForgetObject,
        RelabelObject,
        SaveMap,
        LoadMap,
        SaveState,
        LoadState,
        Reset,
    )
    for service in services:
        fields = service.Response.get_fields_and_field_types()
        assert (fields["code"], fields["message"]) == ("uint8", "string")
        assert service.Response.SUCCESS == 0


def test_actions_say_how_it_ended() -> None:
    assert {VerifyObject.Result.FOUND, VerifyObject.Result.OCCLUDED, VerifyObject.Result.NOT_FOUND} == {
        0,
        1,
        2,
    }
    assert FindObject.Result().message == ""
    assert FindObject.Feedback().reason == ""


def test_messages_can_be_filled_and_nested() -> None:
    state = WorldState(expected_count=2.5)
    assert state.expected_count == 2.5
    result = ObjectHypothesisWithPose()
    result.hypothesis.class_id = "cup"
    assert Detection3DArray().detections == []


def test_definition_has_all_types_a_reader_needs() -> None:
    text = definition("whereabouts_msgs/msg/WorldState")
    named = {line.removeprefix("MSG: ") for line in text.splitlines() if line.startswith("MSG: ")}
    assert {"whereabouts_msgs/WorldObject", "geometry_msgs/Point32", "builtin_interfaces/Time"} <= named
    assert "std_msgs/Header header" in text


def test_unknown_type_is_named() -> None:
    with pytest.raises(UnknownTypeError, match="no_msgs/msg/Nothing"):
        message_class("no_msgs/msg/Nothing")
