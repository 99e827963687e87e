"""Parameters of the node `scan_registration`."""

from __future__ import annotations

from dataclasses import fields

from pydantic import create_model, field_validator

from registration.crf.online import SegmenterConfig
from registration.odometry.follower import OdometryConfig
from whereabouts.parameters.from_config import settings_of
from whereabouts.parameters.parameter_base import FrameParameters, setting

_WithOdometry = create_model(  # type: ignore[call-overload]
    "_WithOdometry",
    __base__=FrameParameters,
    **settings_of(OdometryConfig),
    **settings_of(SegmenterConfig),
)


class ScanRegistrationParameters(_WithOdometry):  # type: ignore[valid-type, misc]
    """Parameters of `scan_registration`: its own, and all of `OdometryConfig` and `SegmenterConfig`."""

    public = (
        "scan_topics", "cloud_topics", "wheel_topic", "use_wheel_odometry", "odom_frame", "base_frame",
        "publish_tf", "max_range", "map_radius", "key_distance", "segment_scans", "publish_static_points",
    )  # fmt: skip

    scan_topics: list[str] = setting(
        ["scan"],
        "topics of planar scanners; scans of the others are joined to those of the first; [''] for none",
        fixed=True,
    )
    cloud_topics: list[str] = setting(
        [""], "topics of 3D scanners; used instead of scans if given", fixed=True
    )
    wheel_topic: str = setting("wheel_odom", "topic of wheel odometry", fixed=True)
    use_wheel_odometry: bool = setting(True, "use wheel_odom, if it arrives, as initial guess")
    max_wheel_age: float = setting(
        0.5, "wheel odometry older than this is not used for a scan", unit="s", ge=0.0, le=10.0
    )
    publish_static_points: bool = setting(True, "publish static_points, the scan without what moves")

    @field_validator("scan_topics", "cloud_topics")
    @classmethod
    def without_duplicates(cls, topics: list[str]) -> list[str]:
        if len(set(topics)) != len(topics):
            raise ValueError("each topic may be named once")
        return topics

    @property
    def odometry(self) -> OdometryConfig:
        """The library's settings."""
        return OdometryConfig(**{item.name: getattr(self, item.name) for item in fields(OdometryConfig)})

    @property
    def segmenter(self) -> SegmenterConfig:
        """The library's settings of what labels movers."""
        return SegmenterConfig(**{item.name: getattr(self, item.name) for item in fields(SegmenterConfig)})

    @property
    def scans(self) -> list[str]:
        """Scan topics in use. ROS cannot tell the type of an empty list, so [''] stands for none."""
        return [topic for topic in self.scan_topics if topic]

    @property
    def clouds(self) -> list[str]:
        """Cloud topics in use."""
        return [topic for topic in self.cloud_topics if topic]
