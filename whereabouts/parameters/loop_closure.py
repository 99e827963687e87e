"""Parameters of the node `loop_closure`."""

from __future__ import annotations

from typing import Literal

from loop_closure.slam_config import SlamConfig
from whereabouts.parameters.parameter_base import (
    BaseFrame,
    FileParameters,
    MapFrame,
    OdomFrame,
    setting,
    setting_of,
)


class LoopClosureParameters(MapFrame, OdomFrame, BaseFrame, FileParameters):
    """Parameters of `loop_closure`."""

    public = (
        "scan_topic", "cloud_topic", "odometry_source", "publish_tf", "map_file", "localization_only",
        "save_period", "resolution", "max_range",
    )  # fmt: skip

    scan_topic: str = setting("scan", "topic of the planar scanner", fixed=True)
    cloud_topic: str = setting("", "topic of a 3D scanner; used instead of scans if given", fixed=True)
    odometry_source: Literal["auto", "tf", "messages"] = setting(
        "auto",
        "where odometry comes from. messages: `odometry`, at the scan's stamp, between messages interpolated; tf: the "
        "transform from odom_frame to base_frame; auto: messages while somebody sends them, else tf. Corrections are "
        "published for tf's odom_frame in any case",
        fixed=True,
    )
    publish_tf: bool = setting(True, "publish the transform from map_frame to odom_frame")
    map_file: str = setting(
        "",
        "path of the map's files without their endings (.npz, .pgm, .yaml); read at the start if they exist",
        fixed=True,
    )
    localization_only: bool = setting(
        False, "only localise in the map that is read at the start; do not extend it", fixed=True
    )
    save_period: float = setting(
        0.0,
        "time between saves to map_file; 0 saves only when asked",
        unit="s",
        ge=0.0,
        le=3600.0,
        fixed=True,
    )
    resolution: float = setting(0.05, "edge of a map cell", unit="m", ge=0.01, le=1.0, fixed=True)
    max_range: float = setting_of(SlamConfig, "max_range")
    key_distance: float = setting_of(SlamConfig, "key_distance")
    loop_path: float = setting_of(SlamConfig, "loop_path")
    proposals: Literal["both", "path", "places"] = setting(
        "both",
        "what says where a loop may close. path: the estimate, within its uncertainty; places: the place classifier "
        "alone, scans only; both: the estimate, and the classifier where that is too uncertain",
        fixed=True,
    )
    tf_period: float = setting(
        0.05, "time between transforms from map to odom", unit="s", ge=0.005, le=5.0, fixed=True
    )
    transform_tolerance: float = setting(
        0.1, "the transform from map to odom is stamped this far ahead", unit="s", ge=0.0, le=10.0
    )
    map_period: float = setting(
        2.0,
        "shortest time between published maps and trajectories; changes of the map go out four times as often",
        unit="s",
        ge=0.05,
        le=600.0,
        fixed=True,
    )
    nav2_services: bool = setting(
        True,
        "offer map_saver/save_map, map_server/load_map, map_server/map and reinitialize_global_localization, as nav2's "
        "nodes do; false where these run",
        fixed=True,
    )

    @property
    def slam(self) -> SlamConfig:
        return self.config_of(SlamConfig)
