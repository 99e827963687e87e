"""Parameters of the node `motion_predictor`."""

from __future__ import annotations

from dataclasses import fields

from pydantic import create_model

from tracking.intentions import IntentionConfig
from whereabouts.parameters.from_config import settings_of
from whereabouts.parameters.parameter_base import FileParameters, setting

_WithIntentions = create_model("_WithIntentions", __base__=FileParameters, **settings_of(IntentionConfig))  # type: ignore[call-overload]


class MotionPredictorParameters(_WithIntentions):  # type: ignore[valid-type, misc]
    """Parameters of `motion_predictor`: its own, and all settings of `IntentionConfig`."""

    public = (
        "map_frame", "base_frame", "map_id", "model_path", "method", "learn", "horizon", "rate",
        "publish_occupancy", "occupancy_horizon", "occupancy_probability", "publish_markers",
    )  # fmt: skip

    map_frame: str = setting("map", "frame of the learned walks and of the predictions", fixed=True)
    base_frame: str = setting(
        "base_link",
        "frame of predicted_occupancy, the robot's; map_frame, or a robot that tf does not know: the map's",
        fixed=True,
    )
    map_id: str = setting("", "name of the map; a saved model of another map is refused", fixed=True)
    model_path: str = setting(
        "", "file that ~/save and ~/load use without a path; read at the start if it exists", fixed=True
    )
    rate: float = setting(5.0, "predictions per second of sensor time", unit="Hz", ge=0.1, le=100.0)
    horizon: float = setting(5.0, "how far ahead is predicted", unit="s", ge=0.1, le=60.0)
    point_interval: float = setting(
        0.5, "time between published points of a path", unit="s", ge=0.05, le=10.0
    )
    track_timeout: float = setting(
        2.0,
        "a track ends, and is learned, after this time without an observation",
        unit="s",
        ge=0.1,
        le=60.0,
        fixed=True,
    )
    learn: bool = setting(True, "learn from finished tracks")
    person_probability: float = setting(
        0.3,
        "targets less likely to be a person than this are ignored; targets without classes are all taken",
        ge=0,
        le=1,
    )
    occupied_from: int = setting(65, "cells of the map at or above this are obstacles", ge=1, le=100)
    publish_markers: bool = setting(True, "publish markers of paths and goals")
    publish_occupancy: bool = setting(True, "publish predicted_occupancy, points for a costmap")
    occupancy_horizon: float = setting(
        3.0, "how far ahead the predicted occupancy reaches", unit="s", ge=0.0, le=60.0
    )
    occupancy_probability: float = setting(
        0.2, "paths to goals less probable than this are left out of predicted_occupancy", ge=0.0, le=1.0
    )
    occupancy_height: float = setting(0.5, "height of the occupied points", unit="m", ge=0.0, le=3.0)

    publish_mask: bool = setting(
        False,
        "publish people_mask and people_filter_info, for a KeepoutFilter of nav2's costmaps",
        fixed=True,
    )
    mask_period: float = setting(
        1.0,
        "shortest time between masks; nav2 warns of each in its log",
        unit="s",
        ge=0.05,
        le=60.0,
        fixed=True,
    )
    mask_radius: float = setting(
        0.45,
        "how far around people's places the mask reaches: their radius and the robot's, as masks are not inflated",
        unit="m",
        ge=0.05,
        le=5.0,
    )

    @property
    def intentions(self) -> IntentionConfig:
        """The library's settings."""
        return IntentionConfig(**{item.name: getattr(self, item.name) for item in fields(IntentionConfig)})
