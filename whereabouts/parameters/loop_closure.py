"""Parameters of the node `loop_closure`."""

from __future__ import annotations

from dataclasses import fields

from pydantic import create_model

from loop_closure.slam_config import SlamConfig
from whereabouts.parameters.base import FileParameters, FrameParameters, setting
from whereabouts.parameters.from_config import settings_of

_WithSlam = create_model("_WithSlam", __base__=(FrameParameters, FileParameters), **settings_of(SlamConfig))  # type: ignore[call-overload]


class LoopClosureParameters(_WithSlam):  # type: ignore[valid-type, misc]
    """Parameters of `loop_closure`: its own, and all settings of `SlamConfig`."""

    map_frame: str = setting("map", "frame that does not drift", fixed=True)
    scan_topic: str = setting("scan", "topic of the planar scanner", fixed=True)
    cloud_topic: str = setting("", "topic of a 3D scanner; used instead of scans if given", fixed=True)
    map_file: str = setting(
        "", "stem of the map's files (.npz, .pgm, .yaml); read at the start if they are there", fixed=True
    )
    localization_only: bool = setting(False, "do not extend the map that is read at the start", fixed=True)
    save_period: float = setting(
        0.0, "time between saves to map_file; 0 for only when asked", unit="s", ge=0.0, le=3600.0, fixed=True
    )
    tf_period: float = setting(
        0.05, "time between transforms from map to odom", unit="s", ge=0.005, le=5.0, fixed=True
    )
    transform_tolerance: float = setting(
        0.1, "how far into the future the transform from map to odom is valid", unit="s", ge=0.0, le=10.0
    )
    map_period: float = setting(
        2.0, "least time between maps and trajectories", unit="s", ge=0.05, le=600.0, fixed=True
    )
    resolution: float = setting(0.05, "edge of a map cell", unit="m", ge=0.01, le=1.0, fixed=True)

    thin: bool = setting(
        True,
        "take out keyframes of places that others show as well: memory grows with the place, not with the time",
        fixed=True,
    )

    @property
    def slam(self) -> SlamConfig:
        """The library's settings."""
        return SlamConfig(**{item.name: getattr(self, item.name) for item in fields(SlamConfig)})
