"""Symbols: predicate grounding relations, and object symbols such as `cup-3` (section 2.4.1).

A predicate symbol stands for a region of attribute space. Both directions are answered: how probably a symbol holds
of an object, from the distributions of its attributes; and which distributions a symbol stands for.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from estimation.errors import InputError
from estimation.geometry.polygons import interval_mass
from world_model.evidence import Distribution

Gaussian = tuple[float, float]  # Mean and variance of one quantity, SI units
OPEN_END = 0.5
"""An interval without upper end is taken to be this much of its lower end wide, where a distribution is asked for."""
SYMBOL = re.compile(r"(.+)-(\d+)")
Interval = Annotated[list[float], Field(min_length=2, max_length=2)]
"""From, to."""
DEGREE = math.pi / 180.0


def _several(given: Any) -> Any:
    """One interval as a list of them."""
    one = isinstance(given, list) and not any(isinstance(part, list) for part in given)
    return [given] if one else given


class _Checked(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class Quantity(_Checked):
    """A number that is measured, in SI units, degrees in the file being radians. period : where it wraps around, None
    where it does not. range : what values it can have."""

    unit: str = ""
    period: float | None = Field(None, gt=0.0, allow_inf_nan=False)
    range: Interval = Field(default_factory=lambda: [-math.inf, math.inf])

    @model_validator(mode="after")
    def _in_units(self) -> Quantity:
        if self.period is not None and self.unit == "degree":
            self.period *= DEGREE
        self.range = self.interval("range", self.range)
        return self

    def interval(self, where: str, given: Interval) -> Interval:
        """An interval of the file in SI units. Raises InputError where it does not ascend."""
        low, high = (value * DEGREE if self.unit == "degree" else value for value in given)
        if self.period is not None and low > high:
            high += self.period
        if not low < high:
            raise InputError(f"{where}: [from, to] ascending expected, got {given!r}")
        return [low, high]


class Predicate(_Checked):
    """One grounding relation g: `where`, intervals by quantity; `any` of other symbols; or neither, for a value of the
    discrete `attribute` only."""

    attribute: str = ""
    where: dict[str, Annotated[list[Interval], BeforeValidator(_several)]] = Field(default_factory=dict)
    any: list[str] = Field(default_factory=list)

    @model_validator(mode="after")
    def _one_of_both(self) -> Predicate:
        if self.any and (self.attribute or self.where):
            raise InputError("either any, or attribute and where")
        if not self.any and not self.attribute:
            raise InputError("an attribute expected")
        return self


class GroundingFile(_Checked):
    """A checked file: quantities, the quantities of measured vectors, predicates, each by name."""

    quantities: dict[str, Quantity] = Field(default_factory=dict)
    vectors: dict[str, Annotated[list[str], Field(min_length=1)]] = Field(default_factory=dict)
    predicates: dict[str, Predicate] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _complete(self) -> GroundingFile:
        for name, parts in self.vectors.items():
            for part in parts:
                self.quantity(f"vector {name!r}", part)
        for name, predicate in self.predicates.items():
            for key, intervals in predicate.where.items():
                where = f"predicate {name!r}, {key}"
                quantity = self.quantity(where, key)
                predicate.where[key] = [quantity.interval(where, each) for each in intervals]
            self._check_acyclic(name, ())
        return self

    def quantity(self, where: str, name: str) -> Quantity:
        """Raises InputError where the file has none of this name."""
        if name not in self.quantities:
            known = ", ".join(self.quantities) or "none"
            raise InputError(f"{where}: unknown quantity {name!r}; known are {known}")
        return self.quantities[name]

    def _check_acyclic(self, name: str, above: tuple[str, ...]) -> None:
        if name in above:
            raise InputError(f"predicate {name!r} is defined by itself")
        for part in self.predicates[name].any:
            if part in self.predicates:
                self._check_acyclic(part, (*above, name))


@dataclass(frozen=True)
class Grounding:
    """What symbols stand for. discrete : {attribute: {value: probability}}. continuous : {quantity: (mean, variance)},
    moments of the uniform distribution over the symbol's ranges."""

    discrete: Mapping[str, Mapping[str, float]]
    continuous: Mapping[str, Gaussian]


class Symbols:
    """The predicate symbols of a deployment, from a mapping as in `defaults/predicates.yaml`.

    Raises InputError naming symbol and field.
    """

    def __init__(self, given: Mapping[str, Any]) -> None:
        self._relations = _read_relations(given)
        self.predicates = self._relations.predicates

    @classmethod
    def load(cls, path: str | Path) -> Symbols:
        """Read a YAML file. Raises InputError naming file and symbol."""
        try:
            given = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
            raise InputError(f"{path}: cannot be read as predicates: {error}") from error
        try:
            return cls(given)
        except InputError as error:
            raise InputError(f"{path}: {error}") from error

    # Symbols of an object.

    def probability(
        self,
        symbol: str,
        attributes: Mapping[str, Distribution],
        quantities: Mapping[str, Gaussian] | None = None,
    ) -> float:
        """That a symbol holds of an object with these attribute distributions, in [0, 1].

        attributes : {"class": {"cup": 0.8, ...}, ...}. quantities : {"hue": (mean, variance)} where they were
        measured. An attribute of which nothing is known is spread evenly over its symbols.
        """
        predicate = self.predicates.get(symbol)
        if predicate is not None and predicate.any:
            parts = (self.probability(part, attributes, quantities) for part in predicate.any)
            return min(sum(parts), 1.0)
        if predicate is None:
            return max((float(values.get(symbol, 0.0)) for values in attributes.values()), default=0.0)
        if quantities and predicate.where and predicate.where.keys() <= quantities.keys():
            return self._mass(predicate, quantities)
        known = attributes.get(predicate.attribute)
        if known:
            return float(known.get(symbol, 0.0))
        return 1.0 / len(self.of_attribute(predicate.attribute))

    def require(self, symbol: str, values: Iterable[str]) -> None:
        """Raises InputError for a word that is neither a predicate nor one of the values of discrete attributes."""
        if symbol not in self.predicates and symbol not in set(values):
            known = ", ".join(self.predicates) or "none"
            raise InputError(
                f"unknown predicate {symbol!r}; known are {known}, and values of discrete attributes"
            )

    def holding(
        self,
        attributes: Mapping[str, Distribution],
        quantities: Mapping[str, Gaussian] | None = None,
        min_probability: float = 0.5,
    ) -> dict[str, float]:
        """Symbols that hold of an object with more than `min_probability`, and how probably, the most probable first.

        Class names and what follows only from ignorance are left out.
        """
        found: dict[str, float] = {}
        for name, values in attributes.items():
            for value, probability in values.items():
                if name != "class" and value not in self.predicates:
                    found[value] = float(probability)
        for symbol, predicate in self.predicates.items():
            measured = quantities and predicate.where.keys() <= quantities.keys()
            if predicate.any or predicate.attribute in attributes or (predicate.where and measured):
                found[symbol] = self.probability(symbol, attributes, quantities)
        likely = {symbol: p for symbol, p in found.items() if p > min_probability}
        return dict(sorted(likely.items(), key=lambda item: -item[1]))

    def of_attribute(self, attribute: str) -> list[str]:
        """Predicates that are values of a discrete attribute."""
        return [name for name, item in self.predicates.items() if item.attribute == attribute]

    # Attributes of symbols.

    def grounding(self, symbols: Iterable[str]) -> Grounding:
        """Attribute distributions that symbols stand for together: of "a small red cup", as evidence or to search for.

        A word that is no predicate is a class name. Raises InputError for symbols that exclude each other.
        """
        discrete: dict[str, dict[str, float]] = {}
        continuous: dict[str, Gaussian] = {}
        for symbol in symbols:
            attribute, values = self._values(symbol)
            known = discrete.get(attribute)
            both = values if known is None else [value for value in values if value in known]
            if not both:
                raise InputError(f"predicate {symbol!r} excludes {', '.join(known or ())}")
            discrete[attribute] = {value: 1.0 / len(both) for value in both}
            predicate = self.predicates.get(symbol)
            for name, intervals in predicate.where.items() if predicate else ():
                continuous[name] = _moments(intervals)
        return Grounding(discrete, continuous)

    def _values(self, symbol: str) -> tuple[str, list[str]]:
        """The attribute that a symbol speaks of, and the values that it allows."""
        predicate = self.predicates.get(symbol)
        if predicate is None:
            return "class", [symbol]
        if not predicate.any:
            return predicate.attribute, [symbol]
        parts = [self._values(part) for part in predicate.any]
        attributes = sorted({attribute for attribute, _ in parts})
        if len(attributes) > 1:
            raise InputError(f"predicate {symbol!r} speaks of several attributes: {', '.join(attributes)}")
        return attributes[0], [value for _, values in parts for value in values]

    # Perception.

    def perceived(
        self, quantities: Mapping[str, Gaussian], known: Mapping[str, Iterable[str]] | None = None
    ) -> dict[str, dict[str, float]]:
        """Measured quantities as discrete attributes: {"hue": (mean, variance)} becomes {"color": {"red": 0.9, ...}}.

        Probabilities sum to one; what falls outside of all regions is spread evenly over the attribute's symbols.
        known : allowed values by attribute, where they are limited.
        """
        found: dict[str, dict[str, float]] = {}
        for symbol, predicate in self.predicates.items():
            allowed = list(known.get(predicate.attribute, ())) if known else []
            complete = predicate.where and predicate.where.keys() <= quantities.keys()
            if complete and (not allowed or symbol in allowed):
                found.setdefault(predicate.attribute, {})[symbol] = self._mass(predicate, quantities)
        for values in found.values():
            total = sum(values.values())
            rest = max(1.0 - total, 0.0) / len(values)
            for symbol, mass in values.items():
                values[symbol] = (mass + rest) / max(total, 1.0)
        return found

    def unpacked(self, name: str, mean: Iterable[float], covariance: Any) -> dict[str, Gaussian]:
        """A measured vector as quantities: ("hsv", (3,), (3, 3)) becomes {"hue": (mean, variance), ...}.

        Correlations are left out. Raises InputError naming the attribute for an unknown one, a wrong size or a
        covariance that is none.
        """
        where = f"attribute {name!r}"
        parts = self._relations.vectors.get(name, (name,))
        for part in parts:
            self._relations.quantity(where, part)
        values = np.asarray(list(mean), dtype=np.float64)
        cov, size = np.asarray(covariance, dtype=np.float64), len(parts)
        if values.shape != (size,) or cov.size != size * size:
            raise InputError(
                f"{where}: {size} values with {size * size} covariances expected, got {len(values)} and {cov.size}"
            )
        cov = cov.reshape(size, size)
        finite = np.isfinite(values).all() and np.isfinite(cov).all()
        if not finite or np.linalg.eigvalsh(0.5 * (cov + cov.T))[0] < -1e-9 * max(1.0, np.abs(cov).max()):
            raise InputError(f"{where}: finite values and a covariance without negative eigenvalues expected")
        return {part: (float(v), float(p)) for part, v, p in zip(parts, values, np.diag(cov), strict=True)}

    def _mass(self, predicate: Predicate, quantities: Mapping[str, Gaussian]) -> float:
        """Probability of a predicate's region, the quantities being independent."""
        product = 1.0
        for name, intervals in predicate.where.items():
            product *= _inside(self._relations.quantities[name], intervals, *quantities[name])
        return product


@cache
def default_symbols() -> Symbols:
    """The shipped `defaults/predicates.yaml`."""
    text = files("world_model").joinpath("defaults/predicates.yaml").read_text(encoding="utf-8")
    return Symbols(yaml.safe_load(text))


def parse_symbol(symbol: str) -> tuple[str, int] | None:
    """("cup", 3) of `cup-3`; None where it is no such symbol."""
    found = SYMBOL.fullmatch(symbol)
    return (found[1], int(found[2])) if found else None


def _inside(quantity: Quantity, intervals: Iterable[Interval], mean: float, variance: float) -> float:
    """Probability that a Gaussian quantity is in one of the intervals."""
    bottom, top = quantity.range
    if quantity.period is None:
        # What is measured beyond the possible values is at their end.
        ends = [
            (-math.inf if low <= bottom else low, math.inf if high >= top else high)
            for low, high in intervals
        ]
        return min(sum(interval_mass(low, high, mean, variance) for low, high in ends), 1.0)
    period = quantity.period
    reach = 2 + math.ceil(4.0 * math.sqrt(variance) / period)
    shifts = [turn * period - mean % period for turn in range(-reach, reach + 1)]
    masses = (interval_mass(low + s, high + s, 0.0, variance) for low, high in intervals for s in shifts)
    return min(sum(masses), 1.0)


def _moments(intervals: Iterable[Interval]) -> Gaussian:
    """Mean and variance of the uniform distribution over intervals."""
    bounds = [
        (low, high if math.isfinite(high) else low + max(OPEN_END * abs(low), 1e-3))
        for low, high in intervals
    ]
    lengths = np.array([high - low for low, high in bounds])
    share = lengths / lengths.sum()
    centres = np.array([0.5 * (low + high) for low, high in bounds])
    mean = float(share @ centres)
    return mean, float(share @ (lengths**2 / 12 + (centres - mean) ** 2))


def _read_relations(given: Any) -> GroundingFile:
    """Check what a file holds. Raises InputError naming symbol and field."""
    try:
        return GroundingFile.model_validate(given)
    except ValidationError as error:
        wrong = error.errors()[0]
        said = wrong["msg"].removeprefix("Value error, ").removesuffix(" or instance of GroundingFile")
        if wrong["type"] != "value_error":
            said += f", got {wrong['input']!r}"
        where = ".".join(map(str, wrong["loc"])) or "predicates"
        raise InputError(f"{where}: {said}") from error
