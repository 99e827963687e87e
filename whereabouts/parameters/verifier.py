"""Parameters of the node `verifier`."""

from __future__ import annotations

from whereabouts.parameters.parameter_base import NodeParameters, setting


class VerifierParameters(NodeParameters):
    """Parameters of `verifier`."""

    public = (
        "map_frame", "scan_topic", "cloud_topic", "use_clouds", "max_range", "points", "timeout",
        "use_map",
    )  # fmt: skip

    map_frame: str = setting("map", "frame of the map, and of regions that name no frame", fixed=True)
    scan_topic: str = setting("scan", "topic of the planar scanner", fixed=True)
    cloud_topic: str = setting("points", "topic of the 3D sensor", fixed=True)
    use_clouds: bool = setting(False, "use points instead of scan", fixed=True)
    frames: int = setting(3, "number of scans or clouds that must agree", ge=1, le=100)
    points: int = setting(
        3, "an object is there if its region has at least this many returns", ge=1, le=100000
    )
    clear: float = setting(0.8, "a region counts as empty only if this share of it was seen", ge=0.05, le=1.0)
    widest: float = setting(
        1.5, "widest region in which any return counts as the object", unit="m", ge=0.05, le=100.0
    )
    timeout: float = setting(
        3.0, "time limit of a decision if the goal states none", unit="s", ge=0.1, le=120.0
    )
    sigma: float = setting(
        0.05, "standard deviation of a verified position, per axis", unit="m", ge=0.001, le=5.0
    )
    max_range: float = setting(8.0, "regions farther away are not verified", unit="m", ge=0.1, le=200.0)
    use_map: bool = setting(True, "ignore returns from what is occupied in the map")
