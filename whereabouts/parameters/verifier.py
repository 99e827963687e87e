"""Parameters of the node `verifier`."""

from __future__ import annotations

from whereabouts.parameters.base import NodeParameters, setting


class VerifierParameters(NodeParameters):
    """Parameters of `verifier`."""

    map_frame: str = setting("map", "frame of regions without one, and of the map", fixed=True)
    use_clouds: bool = setting(False, "look in points instead of scan", fixed=True)
    frames: int = setting(3, "scans or clouds that must agree", ge=1, le=100)
    points: int = setting(3, "returns inside the region that are an object", ge=1, le=100000)
    clear: float = setting(0.8, "share of the region that must be seen for it to be empty", ge=0.05, le=1.0)
    widest: float = setting(
        1.5, "of a region in which a return can be taken for the object", unit="m", ge=0.05, le=100.0
    )
    timeout: float = setting(3.0, "to decide, where the goal states none", unit="s", ge=0.1, le=120.0)
    sigma: float = setting(0.05, "of a verified position per axis", unit="m", ge=0.001, le=5.0)
    max_range: float = setting(8.0, "farther away nothing is verified", unit="m", ge=0.1, le=200.0)
    use_map: bool = setting(True, "returns at what the map has occupied anyway do not count")
