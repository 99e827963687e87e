"""Settings of the people tracker: one default for all places and scanners."""

from __future__ import annotations

from dataclasses import dataclass

from estimation.settings import check_settings, setting


@dataclass(frozen=True)
class PeopleConfig:
    """Settings of `PeopleTracker`; each field's metadata has its unit, meaning and allowed range."""

    max_range: float = setting(10.0, "m", "people farther away are not tracked", 1.0, 100.0)
    join_distance: float = setting(
        0.1, "m", "neighbouring returns closer than this form one cluster", 0.02, 0.5
    )
    acceleration: float = setting(
        2.5,
        "m/s²",
        "standard deviation of the acceleration of somebody who walks, constant from scan to scan",
        0.1,
        10.0,
    )
    leg_noise: float = setting(
        0.14, "m", "standard deviation from one leg to the middle of the person", 0.03, 0.5
    )
    detection_probability: float = setting(
        0.98, "", "probability that what is in plain view gives a cluster of returns", 0.1, 0.999
    )
    memory: float = setting(30.0, "s", "mean time after which somebody out of sight has gone", 0.5, 600.0)
    report: float = setting(0.5, "", "a person is reported from this probability on", 0.05, 0.99)
    located: float = setting(
        1.0, "m", "somebody hidden is reported while the deviation of the place is smaller", 0.1, 20.0
    )
    late_window: float = setting(
        1.0, "s", "a stamp this far behind the last is skipped, but for a second one in a row", 0.0, 60.0
    )
    max_gap: float = setting(5.0, "s", "a longer time between scans is a new run", 0.2, 600.0)

    def __post_init__(self) -> None:
        check_settings(self)
