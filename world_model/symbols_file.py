"""Reads predicate grounding relations; `defaults/predicates.yaml` shows and explains the form of the file."""

from __future__ import annotations

import math
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from estimation.errors import InputError

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


def read_relations(given: Any) -> GroundingFile:
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
