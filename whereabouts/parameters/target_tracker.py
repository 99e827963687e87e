"""Parameters of the node `target_tracker`."""

from __future__ import annotations

from dataclasses import fields
from typing import Literal

from pydantic import create_model

from tracking.people.people_config import PeopleConfig
from whereabouts.parameters.from_config import settings_of
from whereabouts.parameters.parameter_base import NodeParameters, setting
from whereabouts.system.clocks import SECOND, TOLERANCE

# How late a scan may be is the same for all nodes (`whereabouts.system.clocks`).
_SETTINGS = {name: value for name, value in settings_of(PeopleConfig).items() if name != "late_window"}
_WithPeople = create_model("_WithPeople", __base__=NodeParameters, **_SETTINGS)  # type: ignore[call-overload]


class TargetTrackerParameters(_WithPeople):  # type: ignore[valid-type, misc]
    """Parameters of `target_tracker`: its own, and all settings of `PeopleConfig`."""

    public = (
        "scan_topic", "odom_frame", "filter", "max_range", "detection_probability", "report",
        "located", "memory", "use_segments", "trail",
    )  # fmt: skip

    filter: Literal["mixture", "phd", "gmphd"] = setting(
        "mixture",
        "mixture: everything that stands free, with its class; phd: the reference's filter on single returns; gmphd: "
        "its filter for points, on clusters. The last two know no classes and report everything that stands free or "
        "moves",
        fixed=True,
    )
    scan_topic: str = setting("scan", "topic of the planar scanner", fixed=True)
    odom_frame: str = setting("odom", "frame in which people are tracked and published", fixed=True)
    use_segments: bool = setting(True, "use the labels of scan_registration, if they arrive in time")
    drift_window: float = setting(
        30.0,
        "the drift of odometry counts over this time; 0 counts it from the start, so that it grows without limit",
        unit="s",
        ge=0.0,
        le=1e6,
    )
    trail: float = setting(10.0, "length of the trails in the markers", unit="s", ge=0.0, le=600.0)

    @property
    def people(self) -> PeopleConfig:
        """The library's settings."""
        given = {
            item.name: getattr(self, item.name) for item in fields(PeopleConfig) if item.name in _SETTINGS
        }
        return PeopleConfig(late_window=TOLERANCE / SECOND, **given)
