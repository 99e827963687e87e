"""What the arguments of the launch files may be: a slip of the pen would otherwise be another robot's settings."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

TRUTHS = {"true": True, "1": True, "yes": True, "false": False, "0": False, "no": False}
SWITCHES = ("use_sim_time", "rviz", "autostart")
FILES = ("params_file", "nav2_params_file", "bag")


def is_true(text: str) -> bool:
    """Whether a switch is on. Raises KeyError for other words."""
    return TRUTHS[text.strip().lower()]


def check(given: Mapping[str, str]) -> None:
    """Raises ValueError for a switch that is neither on nor off, and for a file that does not exist."""
    for name in SWITCHES:
        word = given.get(name, "false").strip().lower()
        if word not in TRUTHS and (name, word) != ("use_sim_time", "auto"):
            auto = ", auto" if name == "use_sim_time" else ""
            raise ValueError(f"{name}: true, false{auto} expected, got {given[name]!r}")
    for name in FILES:
        path = given.get(name, "")
        if path and not Path(path).exists():
            raise ValueError(f"{name}: {path} does not exist in {Path.cwd()}")
