"""Settings of the people tracker: one default for all places and scanners."""

from __future__ import annotations

from dataclasses import dataclass, field

from estimation.errors import InputError


def _setting(default: float, unit: str, text: str, low: float, high: float) -> float:
    metadata = {"unit": unit, "description": text, "low": low, "high": high}
    value: float = field(default=default, metadata=metadata)
    return value


@dataclass(frozen=True)
class PeopleConfig:
    """Settings of `PeopleTracker`; each field's metadata has its unit, meaning and allowed range."""

    max_range: float = _setting(10.0, "m", "people farther away are not tracked", 1.0, 100.0)
    join_distance: float = _setting(
        0.1, "m", "neighbouring returns closer than this form one cluster", 0.02, 0.5
    )
    acceleration: float = _setting(
        0.7, "m/s^1.5", "process noise: root of the spectral density of a person's acceleration", 0.1, 5.0
    )
    leg_noise: float = _setting(
        0.2, "m", "standard deviation from one leg to the middle of the person", 0.03, 0.5
    )
    body_noise: float = _setting(
        0.06, "m", "standard deviation from two legs or a trunk to the middle of the person", 0.01, 0.5
    )
    gate: float = _setting(0.75, "m", "farthest a leg may be from where the person is expected", 0.3, 2.0)
    detection_probability: float = _setting(
        0.8, "", "probability to detect a person in plain view, per 0.1 s", 0.1, 0.99
    )
    memory: float = _setting(6.0, "s", "mean time a hidden person is remembered", 0.5, 120.0)
    clutter: float = _setting(0.3, "1/m²", "density of clusters that are no person", 0.001, 10.0)
    prior: float = _setting(-4.8, "", "log odds that a new cluster is a person", -10.0, 3.0)
    report: float = _setting(0.5, "", "a person is reported from this probability on", 0.05, 0.99)
    keep: float = _setting(0.1, "", "a reported person stays reported down to this probability", 0.01, 0.99)
    located: float = _setting(
        0.3,
        "",
        "a hidden person is reported while it is within 1 m of the estimate with this probability",
        0.0,
        0.99,
    )
    late_window: float = _setting(
        1.0, "s", "a stamp this far behind the last is skipped, but for a second one in a row", 0.0, 60.0
    )
    max_gap: float = _setting(5.0, "s", "a longer time between scans is a new run", 0.2, 600.0)

    def __post_init__(self) -> None:
        for name, described in self.__dataclass_fields__.items():
            value, low, high = getattr(self, name), described.metadata["low"], described.metadata["high"]
            if not low <= value <= high:
                raise InputError(f"{name}: {low} to {high} expected, got {value}")
        if self.keep > self.report:
            raise InputError(f"keep: at most report = {self.report} expected, got {self.keep}")
