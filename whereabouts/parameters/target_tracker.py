"""Parameters of the node `target_tracker`."""

from __future__ import annotations

from typing import Literal

from tracking.people.people_config import PeopleConfig
from whereabouts.parameters.parameter_base import OdomFrame, setting, setting_of
from whereabouts.system.clocks import NANOSECONDS, TOLERANCE


class TargetTrackerParameters(OdomFrame):
    """Parameters of `target_tracker`."""

    public = (
        "scan_topic", "filter", "max_range", "detection_probability", "report", "located", "memory",
        "acceleration",
    )  # fmt: skip

    scan_topic: str = setting("scan", "topic of the planar scanner", fixed=True)
    filter: Literal["mixture", "phd", "gmphd"] = setting(
        "mixture",
        "mixture: everything that stands free, with its class; phd: the reference's filter on single returns; gmphd: "
        "its filter for points, on clusters. The last two know no classes and report everything that stands free or "
        "moves",
        fixed=True,
    )
    max_range: float = setting_of(PeopleConfig, "max_range")
    detection_probability: float = setting_of(PeopleConfig, "detection_probability")
    report: float = setting_of(PeopleConfig, "report")
    located: float = setting_of(PeopleConfig, "located")
    memory: float = setting_of(PeopleConfig, "memory")
    acceleration: float = setting_of(PeopleConfig, "acceleration")

    @property
    def people(self) -> PeopleConfig:
        """The library's settings; how late a scan may be is the same for all nodes."""
        return self.config_of(PeopleConfig, late_window=TOLERANCE / NANOSECONDS)
