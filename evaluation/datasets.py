"""Where recordings lie that are read in place and never copied."""

from __future__ import annotations

import os
from pathlib import Path

ENVIRONMENT_VARIABLE = "WHEREABOUTS_DATA"


def data_directory() -> Path | None:
    """Folder of recorded data: $WHEREABOUTS_DATA, else `shared/data` beside the checkout, else None."""
    configured = os.environ.get(ENVIRONMENT_VARIABLE)
    if configured:
        return Path(configured) if Path(configured).is_dir() else None
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    return beside if beside.is_dir() else None


def recording(relative: str) -> Path | None:
    """Path of one recording below the data directory, None where it is absent."""
    directory = data_directory()
    if directory is None or not (directory / relative).exists():
        return None
    return directory / relative
