"""Where the packages are imported from: `tracking` and `estimation` are names that others use, too."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import sys
from pathlib import Path

from whereabouts.robot.findings import Finding, error, note

OWN = ("estimation", "registration", "loop_closure", "tracking", "world_model", "whereabouts")
ROS = ("rclpy", "sensor_msgs", "tf2_msgs", "vision_msgs", "map_msgs", "whereabouts_msgs")
OTHERS = {
    "gtsam": "no loops are closed",
    "small_gicp": "clouds cannot be registered",
    "kiss_icp": "clouds cannot be followed",
    "kiss_matcher": "clouds are not placed without a guess",
}
"""Other people's packages, and what goes without them."""
MISSING = "not installed"


def origins() -> dict[str, str]:
    """Folder of each package and, of other people's, the version; "not installed" where there is none."""
    found = {"python": f"{sys.version.split()[0]}, {sys.executable}"}
    for name in (*OWN, *ROS, *OTHERS):
        found[name] = _origin(name)
    return found


def _origin(name: str) -> str:
    loaded = sys.modules.get(name)
    if loaded is not None and loaded.__spec__ is None:
        return MISSING  # something that stands in for it
    spec = importlib.util.find_spec(name)
    if spec is None or (spec.origin is None and not spec.submodule_search_locations):
        return MISSING
    if spec.origin is None:
        return str(next(iter(spec.submodule_search_locations or ["?"])))
    place = str(Path(spec.origin).parent)
    try:
        return f"{place} ({importlib.metadata.version(name)})" if name in OTHERS else place
    except importlib.metadata.PackageNotFoundError:
        return place


def import_findings(places: dict[str, str]) -> list[Finding]:
    """What is wrong with where packages come from."""
    said = []
    home = Path(places["whereabouts"]).parent
    for name in OWN:
        if Path(places[name]).parent != home:
            said.append(
                error(
                    f"`{name}` is imported from {places[name]} and not from {home}: another package of that name "
                    "goes before it. Use an environment of its own, or correct PYTHONPATH"
                )
            )
    missing = [name for name in ROS if places[name] == MISSING]
    if missing:
        said.append(note(f"no nodes can run here: {', '.join(missing)} not installed"))
    said += [
        note(f"{name} is not installed: {what}") for name, what in OTHERS.items() if places[name] == MISSING
    ]
    return said
