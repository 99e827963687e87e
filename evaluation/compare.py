"""Which figures left their spread between two results, and whether for the better."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from estimation.errors import InputError
from evaluation.results import Result, read, read_all

ROUNDING = 5e-3
"""Share of a figure without a spread that is no difference: what three digits show."""
TIMES = ("s", "ms", "µs", "min")
VERDICTS = ("worse", "better", "changed", "gone", "new")
BUSY = 0.3
"""Share by which a time varies from one machine's hour to the next."""


@dataclass(frozen=True)
class FigureChange:
    """A figure that left its spread. verdict : "better", "worse", "changed", "new" or "gone"."""

    experiment: str
    key: str
    old: float | None
    new: float | None
    spread: float
    unit: str
    verdict: str
    data: str


def load(path: Path) -> dict[str, Result]:
    """Results of a folder, or of one file.

    Raises
    ------
    InputError : there are none.
    """
    found = read_all(path) if path.is_dir() else {path.stem: read(path)}
    if not found:
        raise InputError(
            f"{path}: no results (NAME.json) here; `whereabouts experiment all --out {path}` writes them"
        )
    return {result.name: result for result in found.values()}


def compare(old: Mapping[str, Result], new: Mapping[str, Result]) -> list[FigureChange]:
    """All figures of the experiments in both that left their spread, and those that are in one only."""
    changes: list[FigureChange] = []
    for name in (name for name in old if name in new):
        before, after = old[name].figures, new[name].figures
        for key in dict.fromkeys((*before, *after)):
            change = _change(name, key, before.get(key), after.get(key))
            if change is not None:
                changes.append(change)
    return changes


def warnings(old: Mapping[str, Result], new: Mapping[str, Result]) -> list[str]:
    """Why a comparison may mean less than it seems."""
    said = []
    for name in (name for name in old if name in new):
        for word, what in (
            ("quick", "one of the two is a quick run"),
            ("processor", "times are of two machines"),
        ):
            if old[name].content[word] != new[name].content[word]:
                said.append(f"{name}: {what}")
        if old[name].content["recordings"] != new[name].content["recordings"]:
            said.append(f"{name}: the recordings differ")
    for name in sorted(set(old) ^ set(new)):
        said.append(f"{name}: in one of the two only")
    return said


def spread(figure: Mapping[str, Any]) -> float:
    """Two standard errors of the mean over the seeds, and no less than rounding or, for times, a busy machine hides."""
    values = [value for value in figure.get("values", ()) if value is not None]
    value = figure["value"] or 0.0
    least = (BUSY if figure.get("unit") in TIMES else ROUNDING) * abs(value)
    if len(values) < 2:
        return least
    mean = sum(values) / len(values)
    variance = sum((each - mean) ** 2 for each in values) / (len(values) - 1)
    return max(2.0 * math.sqrt(variance / len(values)), least)


def _change(
    experiment: str, key: str, old: Mapping[str, Any] | None, new: Mapping[str, Any] | None
) -> FigureChange | None:
    one = new or old
    assert one is not None
    unit, data = one.get("unit", ""), one.get("data", "")
    if old is None or new is None or old["value"] is None or new["value"] is None:
        if old is not None and new is not None and old["value"] == new["value"]:
            return None
        verdict = "new" if old is None or old["value"] is None else "gone"
        before, after = (each["value"] if each else None for each in (old, new))
        return FigureChange(experiment, key, before, after, 0.0, unit, verdict, data)
    allowed = math.hypot(spread(old), spread(new))
    difference = new["value"] - old["value"]
    if abs(difference) <= allowed:
        return None
    direction = {"lower": -1.0, "higher": 1.0}.get(one.get("better", ""), 0.0)
    verdict = "changed" if not direction else "better" if difference * direction > 0.0 else "worse"
    return FigureChange(experiment, key, old["value"], new["value"], allowed, unit, verdict, data)


def ordered(changes: Sequence[FigureChange]) -> list[FigureChange]:
    """What is worse first, then what is better, what changed and what is in one only."""
    return sorted(changes, key=lambda change: (VERDICTS.index(change.verdict), change.experiment, change.key))
