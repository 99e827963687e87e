"""Parameters of the node `loop_closure`."""

from __future__ import annotations

from dataclasses import fields
from typing import Literal

from pydantic import create_model

from estimation.geometry.tiles import VIEW_CELLS
from loop_closure.slam_config import SlamConfig
from whereabouts.parameters.from_config import settings_of
from whereabouts.parameters.parameter_base import FileParameters, FrameParameters, setting

_WithSlam = create_model("_WithSlam", __base__=(FrameParameters, FileParameters), **settings_of(SlamConfig))  # type: ignore[call-overload]


class LoopClosureParameters(_WithSlam):  # type: ignore[valid-type, misc]
    """Parameters of `loop_closure`: its own, and all settings of `SlamConfig`."""

    public = (
        "scan_topic", "cloud_topic", "odometry_source", "map_frame", "odom_frame", "base_frame",
        "publish_tf", "map_file", "localization_only", "save_period", "resolution", "max_range",
    )  # fmt: skip

    map_frame: str = setting("map", "map frame: does not drift, but may jump", fixed=True)
    scan_topic: str = setting("scan", "topic of the planar scanner", fixed=True)
    cloud_topic: str = setting("", "topic of a 3D scanner; used instead of scans if given", fixed=True)
    odometry_source: Literal["auto", "tf", "messages"] = setting(
        "auto",
        "where odometry comes from. messages: `odometry`, at the scan's stamp, between messages interpolated; tf: the "
        "transform from odom_frame to base_frame; auto: messages while somebody sends them, else tf. Corrections are "
        "published for tf's odom_frame in any case",
        fixed=True,
    )
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
    tf_period: float = setting(
        0.05, "time between transforms from map to odom", unit="s", ge=0.005, le=5.0, fixed=True
    )
    transform_tolerance: float = setting(
        0.1, "the transform from map to odom is stamped this far ahead", unit="s", ge=0.0, le=10.0
    )
    map_period: float = setting(
        2.0, "shortest time between published maps and trajectories", unit="s", ge=0.05, le=600.0, fixed=True
    )
    map_update_period: float = setting(
        0.5,
        "shortest time between messages on map_updates; they are published only while there is a subscriber",
        unit="s",
        ge=0.05,
        le=600.0,
        fixed=True,
    )
    map_cells: int = setting(
        VIEW_CELLS,
        "largest number of cells of a published or saved map; the rest is left out, with a warning",
        ge=10_000,
        le=400_000_000,
        fixed=True,
    )
    nav2_services: bool = setting(
        True,
        "offer map_saver/save_map, map_server/load_map, map_server/map and reinitialize_global_localization, as nav2's "
        "nodes do; false where these run",
        fixed=True,
    )
    resolution: float = setting(0.05, "edge of a map cell", unit="m", ge=0.01, le=1.0, fixed=True)

    proposals: Literal["both", "path", "places"] = setting(
        "both",
        "what says where a loop may close. path: the estimate, within its uncertainty; places: the place classifier "
        "alone, scans only; both: the estimate, and the classifier where that is too uncertain",
        fixed=True,
    )
    thin: bool = setting(
        True,
        "remove keyframes of places that others cover: memory then grows with the area, not with time",
        fixed=True,
    )

    @property
    def slam(self) -> SlamConfig:
        """The library's settings."""
        return SlamConfig(**{item.name: getattr(self, item.name) for item in fields(SlamConfig)})
