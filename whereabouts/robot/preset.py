"""Presets of robots and usual names, as data in `presets/`."""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from typing import Any

import yaml
from pydantic import BaseModel, ConfigDict, Field

from estimation.errors import InputError

NAMES = "names"


class Preset(BaseModel):
    """What is known of a kind of robot.

    parameters : of nodes by name, beside what the frames and topics say. wheel_topic : "" where there are none.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    about: str
    base_frame: str
    odom_frame: str
    scan_topics: list[str]
    wheel_topic: str
    base_publishes_tf: bool
    parameters: dict[str, dict[str, Any]] = Field(default_factory=dict)


class UsualNames(BaseModel):
    """What robots call their frames and topics, most usual first."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    above_the_robot: list[str]
    robot: list[str]
    wheels: list[str]
    not_wheels: list[str]


def preset_names() -> list[str]:
    folder = files("whereabouts.robot") / "presets"
    stems = [item.name.removesuffix(".yaml") for item in folder.iterdir() if item.name.endswith(".yaml")]
    return sorted(name for name in stems if name != NAMES)


def preset(name: str) -> Preset:
    """Raises InputError where there is no such preset."""
    if name not in preset_names():
        raise InputError(f"--preset: one of {', '.join(preset_names())} expected, got {name!r}")
    return Preset.model_validate(_read(name))


@cache
def usual_names() -> UsualNames:
    """What robots call things."""
    return UsualNames.model_validate(_read(NAMES))


def _read(name: str) -> Any:
    text = (files("whereabouts.robot") / "presets" / f"{name}.yaml").read_text(encoding="utf-8")
    return yaml.safe_load(text)
