"""How the demo runs the suite on the recorded apartment: parameters of all eight nodes, and what is recorded."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from whereabouts.simulation.home.apartment_day import LOOK_RATE, THINGS
from whereabouts.simulation.home.floor_plan import places_file

RECORDED = [
    ("odometry", "nav_msgs/msg/Odometry"),
    ("loop_closures", "whereabouts_msgs/msg/LoopClosure"),
    ("trajectory", "nav_msgs/msg/Path"),
    ("map", "nav_msgs/msg/OccupancyGrid"),
    ("tf", "tf2_msgs/msg/TFMessage"),
    ("targets", "whereabouts_msgs/msg/TargetArray"),
    ("predicted_paths", "whereabouts_msgs/msg/PredictedPathArray"),
    ("world_state", "whereabouts_msgs/msg/WorldState"),
    ("verification_tasks", "whereabouts_msgs/msg/VerificationTask"),
    ("evidence", "whereabouts_msgs/msg/WorldEvidence"),
    ("diagnostics", "diagnostic_msgs/msg/DiagnosticArray"),
]


def parameters(folder: Path) -> dict[str, dict[str, Any]]:
    """Parameters by node, on top of the shipped files. folder : for the world model's memory."""
    items = [item for item, _ in THINGS.values()]
    places = str(places_file())
    return {
        "scan_registration": {},
        "loop_closure": {"map_period": 5.0, "tf_period": 1.0, "transform_tolerance": 0.5},
        "target_tracker": {},
        "motion_predictor": {"rate": 2.0},
        "world_model": {
            "rate_hz": float(LOOK_RATE),
            "classes": sorted({item.kind for item in items} | {"person", "other"}),
            "colors": sorted({item.color for item in items}),
            "region": [-2.0, 9.0, -5.5, 6.2, -0.2, 2.0],
            "places_file": places,
            "store_path": str(folder / "world.sqlite"),
        },
        # People come and go, and are not looked after.
        "world_maintenance": {
            "sensors": ["laser"],
            "sensor_range_max": [4.0],
            "verify_timeout": 8.0,
            "class_names": ["person", "other"],
            "class_values": [1e6, 1e6],
        },
        "verifier": {},
        "object_search": {"places_file": places, "together_distance": 1.5},
    }
