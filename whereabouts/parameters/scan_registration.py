"""Parameters of the node `scan_registration`."""

from __future__ import annotations

from pydantic import field_validator

from registration.crf.online import SegmenterConfig
from registration.odometry.odometry_config import OdometryConfig
from whereabouts.parameters.parameter_base import BaseFrame, OdomFrame, setting, setting_of


class ScanRegistrationParameters(BaseFrame, OdomFrame):
    """Parameters of `scan_registration`."""

    public = (
        "scan_topics", "cloud_topics", "wheel_topic", "publish_tf", "max_range", "map_radius", "key_distance",
        "doubt", "cloud_voxel_size", "segment_scans",
    )  # fmt: skip

    scan_topics: list[str] = setting(
        ["scan"],
        "topics of planar scanners; scans of the others are joined to those of the first; [''] for none",
        fixed=True,
    )
    cloud_topics: list[str] = setting(
        [""], "topics of 3D scanners; used instead of scans if given", fixed=True
    )
    wheel_topic: str = setting(
        "wheel_odom", "topic of wheel odometry, the initial guess where it arrives; empty: none", fixed=True
    )
    publish_tf: bool = setting(True, "publish the transform from odom_frame to base_frame")
    max_range: float = setting_of(OdometryConfig, "max_range")
    map_radius: float = setting_of(OdometryConfig, "map_radius")
    key_distance: float = setting_of(OdometryConfig, "key_distance")
    doubt: float = setting_of(OdometryConfig, "doubt")
    cloud_voxel_size: float = setting_of(OdometryConfig, "cloud_voxel_size")
    segment_scans: bool = setting_of(SegmenterConfig, "segment_scans")
    segment_deadline: float = setting_of(SegmenterConfig, "segment_deadline")

    @field_validator("scan_topics", "cloud_topics")
    @classmethod
    def without_duplicates(cls, topics: list[str]) -> list[str]:
        if len(set(topics)) != len(topics):
            raise ValueError("each topic may be named once")
        return topics

    @property
    def odometry(self) -> OdometryConfig:
        return self.config_of(OdometryConfig)

    @property
    def segmenter(self) -> SegmenterConfig:
        return self.config_of(SegmenterConfig)

    @property
    def scans(self) -> list[str]:
        """Scan topics in use. ROS cannot tell the type of an empty list, so [''] stands for none."""
        return [topic for topic in self.scan_topics if topic]

    @property
    def clouds(self) -> list[str]:
        return [topic for topic in self.cloud_topics if topic]
