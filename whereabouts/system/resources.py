"""Where configuration and launch files lie, in a checkout, a wheel or a colcon workspace."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from estimation.errors import WhereaboutsError


class ResourceError(WhereaboutsError):
    """A file that belongs to the installation is not where it should be."""


def share_directory() -> Path:
    """Folder with config/, launch/ and rviz/: the checkout's, else share/whereabouts of the installation.

    Raises ResourceError: found in none of the usual places; the message lists them.
    """
    checkout = Path(__file__).resolve().parents[2]
    prefixes = [
        Path(prefix) for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix
    ]
    candidates = [prefix / "share" / "whereabouts" for prefix in [Path(sys.prefix), *prefixes]]
    if (checkout / "package.xml").exists():
        candidates.insert(0, checkout)
    for candidate in candidates:
        if (candidate / "config").is_dir():
            return candidate
    raise ResourceError(
        f"whereabouts is installed without its share files; looked in {', '.join(map(str, candidates))}"
    )


def config_file(name: str) -> Path:
    path = share_directory() / "config" / name
    if not path.exists():
        raise ResourceError(f"{path} does not exist")
    return path
