"""What a parameter file says reaches the library that it is about, and what cannot be is refused by name."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from whereabouts.parameter_file import ParameterFileError, settings_for


def given(path: Path, node: str, parameters: dict[str, Any]) -> Any:
    """The settings of a node whose file gives it some parameters; YAML takes JSON."""
    path.write_text(json.dumps({node: {"ros__parameters": parameters}}))
    return settings_for(path, node)


@pytest.mark.parametrize(
    ("node", "library", "parameters"),
    [
        (
            "scan_registration",
            "odometry",
            {"max_range": 3.5, "map_radius": 9.0, "key_distance": 0.1, "doubt": 0.6, "cloud_voxel_size": 0.3},
        ),
        ("scan_registration", "segmenter", {"segment_scans": False, "segment_deadline": 0.02}),
        ("loop_closure", "slam", {"max_range": 3.5, "key_distance": 0.3, "loop_path": 20.0}),
        (
            "target_tracker",
            "people",
            {"acceleration": 4.0, "report": 0.7, "located": 2.0, "memory": 60.0},
        ),
        ("motion_predictor", "intentions", {"method": "ghmm"}),
        (
            "world_model",
            "world",
            {"class_accuracy": 0.7, "missed_run_frames": 5.0, "new_objects_per_second": 0.001,
             "removed_per_second": 0.002, "attributes": ["brand"]},
        ),
        ("world_maintenance", "maintenance", {"cost_scale": 20.0, "standoff": 0.05, "speed": 0.3}),
        ("world_maintenance", "maintenance", {"company": 1.0, "tour": 0.0, "anticipation": 1.0}),
        ("object_search", "search", {"method": "chain", "view": 3.0}),
    ],
)  # fmt: skip
def test_settings_reach_the_library(
    node: str, library: str, parameters: dict[str, Any], tmp_path: Path
) -> None:
    settings = getattr(given(tmp_path / "p.yaml", node, parameters), library)
    assert {name: getattr(settings, name) for name in parameters} == parameters


def test_classes_and_sensors_are_lists_side_by_side(tmp_path: Path) -> None:
    parameters = {
        "class_names": ["person", "cup"], "class_values": [9.0, 2.0],
        "sensors": ["near", "far"], "sensor_range_min": [0.1, 1.0], "sensor_range_max": [1.0, 4.0],
        "sensor_sigma": [0.01, 0.1],
    }  # fmt: skip
    settings = given(tmp_path / "p.yaml", "world_maintenance", parameters)
    assert settings.maintenance.class_thresholds == {"person": 9.0, "cup": 2.0}
    far = settings.sensor_models[1]
    assert (far.name, far.range_min, far.range_max) == ("far", 1.0, 4.0)
    np.testing.assert_allclose(far.covariance, 0.01 * np.eye(3))


@pytest.mark.parametrize(
    ("node", "name", "value"),
    [
        ("scan_registration", "scan_topics", ["scan", "scan"]),
        ("loop_closure", "save_period", -1.0),
        ("loop_closure", "proposals", "all"),
        ("loop_closure", "transform_tolerance", 11.0),
        ("motion_predictor", "occupancy_horizon", 61.0),
        ("motion_predictor", "occupancy_probability", 1.1),
        ("world_model", "depth_from_scan", "depth"),
        ("world_model", "camera_rectified", "P"),
        ("world_model", "region", [0.0, 1.0]),
        ("world_maintenance", "arrival_distance", 0.0),
        ("world_maintenance", "task_timeout", 0.5),
        ("world_maintenance", "sensor_sigma", [0.1, 0.1]),
        ("object_search", "together_distance", 0.0),
    ],
)
def test_what_cannot_be_is_refused_by_name(node: str, name: str, value: Any, tmp_path: Path) -> None:
    with pytest.raises(ParameterFileError, match=name):
        given(tmp_path / "p.yaml", node, {name: value})


@pytest.mark.parametrize(
    ("node", "name", "read"),
    [
        ("object_search", "relations_file", "relations"),
        ("world_model", "predicates_file", "symbols"),
        ("world_model", "places_file", "places"),
    ],
)
def test_a_file_that_is_not_there_is_named(node: str, name: str, read: str, tmp_path: Path) -> None:
    settings = given(tmp_path / "p.yaml", node, {name: "/nowhere.yaml"})
    with pytest.raises(ValueError, match=r"/nowhere\.yaml"):
        getattr(settings, read)
