"""Pictures of experiments: matplotlib figures that need no display."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure


def saved(figure: Figure, path: Path, dpi: int) -> Path:
    """Write a figure as PNG, laid out tightly where it has no layout of its own; returns the path."""
    if figure.get_layout_engine() is None:
        figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=dpi)
    return path
