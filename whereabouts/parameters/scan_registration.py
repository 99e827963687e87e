"""Parameters of the node `scan_registration`."""

from __future__ import annotations

from pydantic import field_validator

from whereabouts.parameters.base import FrameParameters, setting


class ScanRegistrationParameters(FrameParameters):
    """Parameters of `scan_registration`."""

    scan_topics: list[str] = setting(
        ["scan"], "topics of planar scanners, all registered to one map; [''] for none", fixed=True
    )
    cloud_topics: list[str] = setting(
        [""], "topics of 3D scanners; used instead of scans if given", fixed=True
    )
    use_wheel_odometry: bool = setting(True, "take wheel_odom, where it arrives, as the first guess")
    max_wheel_age: float = setting(
        0.5, "wheel odometry older than this before a scan is not used", unit="s", ge=0.0, le=10.0
    )
    publish_static_points: bool = setting(True, "publish static_points, the scan without movers")
    max_range: float = setting(
        80.0, "points farther from the sensor are not used", unit="m", ge=0.5, le=1000.0, fixed=True
    )

    @field_validator("scan_topics", "cloud_topics")
    @classmethod
    def without_duplicates(cls, topics: list[str]) -> list[str]:
        if len(set(topics)) != len(topics):
            raise ValueError("each topic may be named once")
        return topics

    @property
    def scans(self) -> list[str]:
        """Scan topics in use. ROS cannot tell the type of an empty list, so [''] stands for none."""
        return [topic for topic in self.scan_topics if topic]

    @property
    def clouds(self) -> list[str]:
        """Cloud topics in use."""
        return [topic for topic in self.cloud_topics if topic]
