"""Parameters of the node `motion_predictor`."""

from __future__ import annotations

from typing import Literal

from tracking.intentions import IntentionConfig
from whereabouts.parameters.parameter_base import BaseFrame, FileParameters, MapFrame, setting, setting_of


class MotionPredictorParameters(MapFrame, BaseFrame, FileParameters):
    """Parameters of `motion_predictor`."""

    public = (
        "map_id", "model_path", "method", "learn", "horizon", "rate", "occupancy_horizon",
        "occupancy_probability", "publish_mask", "mask_radius",
    )  # fmt: skip

    map_id: str = setting("", "name of the map; a saved model of another map is refused", fixed=True)
    model_path: str = setting(
        "", "file that ~/save and ~/load use without a path; read at the start if it exists", fixed=True
    )
    method: Literal["routes", "ghmm", "printed"] = setting_of(IntentionConfig, "method")
    learn: bool = setting(True, "learn from finished tracks")
    horizon: float = setting(5.0, "how far ahead is predicted", unit="s", ge=0.1, le=60.0)
    rate: float = setting(5.0, "predictions per second of sensor time", unit="Hz", ge=0.1, le=100.0)
    occupancy_horizon: float = setting(
        3.0, "how far ahead predicted_occupancy and the mask reach", unit="s", ge=0.0, le=60.0
    )
    occupancy_probability: float = setting(
        0.2, "paths to goals less probable than this are left out of predicted_occupancy", ge=0.0, le=1.0
    )
    publish_mask: bool = setting(
        False,
        "publish people_mask and people_filter_info, for a KeepoutFilter of nav2's costmaps",
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
        return self.config_of(IntentionConfig)
