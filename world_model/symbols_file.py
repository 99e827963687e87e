"""Reads predicate grounding relations; `defaults/predicates.yaml` shows and explains the form of the file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from estimation.errors import InputError

Interval = tuple[float, float]
EVERYTHING: Interval = (-math.inf, math.inf)


@dataclass(frozen=True)
class Predicate:
    """One grounding relation g: `where`, intervals by quantity; `any` of other symbols; or neither, for a value of the
    discrete `attribute` only."""

    name: str
    attribute: str = ""
    where: tuple[tuple[str, tuple[Interval, ...]], ...] = ()
    any: tuple[str, ...] = ()


@dataclass(frozen=True)
class Quantity:
    """A number that is measured. factor : its unit in the file, in SI units. period : where it wraps around, None where
    it does not. range : what values it can have."""

    name: str
    factor: float = 1.0
    period: float | None = None
    range: Interval = EVERYTHING


@dataclass(frozen=True)
class GroundingFile:
    """A checked file: quantities, the quantities of measured vectors, predicates, each by name."""

    quantities: Mapping[str, Quantity]
    vectors: Mapping[str, tuple[str, ...]]
    predicates: Mapping[str, Predicate]

    def quantity(self, where: str, name: Any) -> Quantity:
        """Raises InputError where the file has none of this name."""
        return _known(where, name, self.quantities)


def read_relations(given: Any) -> GroundingFile:
    """Check what a file holds. Raises InputError naming symbol and field."""
    given = _mapping("predicates", given)
    _only("predicates", given, "quantities", "vectors", "predicates")
    quantities = {
        name: _quantity(name, about)
        for name, about in _mapping("quantities", given.get("quantities", {})).items()
    }
    vectors = {
        name: tuple(_known(f"vector {name!r}", part, quantities).name for part in _list(name, parts))
        for name, parts in _mapping("vectors", given.get("vectors", {})).items()
    }
    predicates = {
        str(name): _predicate(str(name), about, quantities)
        for name, about in _mapping("predicates", given.get("predicates", {})).items()
    }
    for predicate in predicates.values():
        _check_acyclic(predicate, predicates, ())
    return GroundingFile(quantities, vectors, predicates)


def _quantity(name: str, given: Any) -> Quantity:
    where = f"quantity {name!r}"
    about = _mapping(where, given)
    _only(where, about, "unit", "period", "range")
    factor = math.pi / 180 if about.get("unit") == "degree" else 1.0
    period = _number(f"{where}, period", about["period"]) * factor if "period" in about else None
    bounds = EVERYTHING
    if "range" in about:
        bounds = _interval(f"{where}, range", about["range"], Quantity(name, factor))
    return Quantity(name, factor, period, bounds)


def _predicate(name: str, given: Any, quantities: Mapping[str, Quantity]) -> Predicate:
    where = f"predicate {name!r}"
    about = _mapping(where, given)
    _only(where, about, "attribute", "where", "any")
    if "any" in about:
        if len(about) > 1:
            raise InputError(f"{where}: either any, or attribute and where")
        parts = _list(f"{where}, any", about["any"])
        if not all(isinstance(part, str) for part in parts):
            raise InputError(f"{where}, any: a list of symbols expected, got {parts!r}")
        return Predicate(name, any=tuple(parts))
    attribute = about.get("attribute")
    if not isinstance(attribute, str) or not attribute:
        raise InputError(f"{where}: an attribute expected, got {attribute!r}")
    ranges = _mapping(f"{where}, where", about.get("where", {}))
    intervals = {
        key: _intervals(f"{where}, {key}", value, _known(where, key, quantities))
        for key, value in ranges.items()
    }
    return Predicate(name, attribute, tuple(intervals.items()))


def _intervals(where: str, given: Any, quantity: Quantity) -> tuple[Interval, ...]:
    several = _list(where, given)
    pairs = several if isinstance(several[0], list) else [several]
    return tuple(_interval(where, pair, quantity) for pair in pairs)


def _interval(where: str, given: Any, quantity: Quantity) -> Interval:
    if not isinstance(given, list) or len(given) != 2:
        raise InputError(f"{where}: [from, to] expected, got {given!r}")
    low, high = (_number(where, value) * quantity.factor for value in given)
    if quantity.period is not None and low > high:
        high += quantity.period
    if not low < high:
        raise InputError(f"{where}: [from, to] ascending expected, got {given!r}")
    return low, high


def _check_acyclic(predicate: Predicate, known: Mapping[str, Predicate], above: tuple[str, ...]) -> None:
    if predicate.name in above:
        raise InputError(f"predicate {predicate.name!r} is defined by itself")
    for part in predicate.any:
        if part in known:
            _check_acyclic(known[part], known, (*above, predicate.name))


def _known(where: str, name: Any, quantities: Mapping[str, Quantity]) -> Quantity:
    if name not in quantities:
        raise InputError(f"{where}: unknown quantity {name!r}; known are {', '.join(quantities) or 'none'}")
    return quantities[name]


def _only(where: str, given: Mapping[str, Any], *allowed: str) -> None:
    unknown = [str(key) for key in given if key not in allowed]
    if unknown:
        raise InputError(f"{where} has unknown fields: {', '.join(unknown)}")


def _mapping(where: str, given: Any) -> Mapping[str, Any]:
    if not isinstance(given, Mapping):
        raise InputError(f"{where} must be a mapping, not {given!r}")
    return given


def _list(where: str, given: Any) -> list[Any]:
    if not isinstance(given, list) or not given:
        raise InputError(f"{where}: a list expected, got {given!r}")
    return given


def _number(where: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or math.isnan(value):
        raise InputError(f"{where}: a number expected, got {value!r}")
    return float(value)
