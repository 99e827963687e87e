"""Parameters of the node `verifier`."""

from __future__ import annotations

from whereabouts.parameters.parameter_base import MapFrame, setting


class VerifierParameters(MapFrame):
    """Parameters of `verifier`."""

    public = ("scan_topic", "cloud_topic", "max_range", "frames", "points")

    scan_topic: str = setting("scan", "topic of the planar scanner", fixed=True)
    cloud_topic: str = setting("", "topic of a 3D sensor; used instead of scans if given", fixed=True)
    max_range: float = setting(8.0, "regions farther away are not verified", unit="m", ge=0.1, le=200.0)
    frames: int = setting(3, "number of scans or clouds that must agree", ge=1, le=100)
    points: int = setting(
        3, "an object is there if its region has at least this many returns", ge=1, le=100000
    )
