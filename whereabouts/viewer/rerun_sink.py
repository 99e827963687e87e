"""Draws shapes in Rerun; the only module that needs `rerun-sdk`."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from estimation.errors import WhereaboutsError
from whereabouts.viewer.drawable import Boxes, Lines, PlaceShape, Points, Shape, TextNote, Value

APPLICATION = "whereabouts"
TIMELINE = "time"


class NoViewerError(WhereaboutsError):
    """Rerun is not installed, or its window does not open."""


def import_rerun() -> Any:
    """The module `rerun`.

    Raises NoViewerError: not installed; the message says how to get it.
    """
    try:
        import rerun
    except ImportError as error:
        raise NoViewerError(
            "the viewer needs rerun-sdk, which is optional: `pip install -r requirements/viewer.txt`, or "
            f"`pip install rerun-sdk`; --picture FILE.png works without it ({error})"
        ) from None
    return rerun


class RerunSink:
    """A recording in Rerun: a window, or with `save` a file. A context manager."""

    def __init__(self, save: Path | None = None) -> None:
        self._rerun = import_rerun()
        self._recording = self._rerun.RecordingStream(APPLICATION)
        blueprint = self._layout()
        if save is not None:
            self._recording.save(save, default_blueprint=blueprint)
        else:
            try:
                self._recording.spawn(default_blueprint=blueprint)
            except Exception as error:  # whatever keeps a window from opening on this machine
                raise NoViewerError(
                    f"the viewer's window does not open ({error}); --save FILE.rrd needs none"
                ) from None

    def __enter__(self) -> RerunSink:
        return self

    def __exit__(self, *_: object) -> None:
        self._recording.flush()
        self._recording.disconnect()

    def draw(self, stamp: float, shapes: Iterable[Shape]) -> None:
        """Shapes that hold from `stamp` (s) on."""
        self._recording.set_time(TIMELINE, timestamp=stamp)
        for shape in shapes:
            static = isinstance(shape, PlaceShape) and shape.static
            # Rerun escapes what the parts of a path hold.
            self._recording.log(shape.path.split("/"), self._component(shape), static=static)

    def _component(self, shape: Shape) -> Any:
        rr = self._rerun
        if isinstance(shape, PlaceShape):
            return rr.Transform3D(translation=shape.matrix[:3, 3], mat3x3=shape.matrix[:3, :3])
        if isinstance(shape, Points):
            return rr.Points3D(
                shape.positions, radii=shape.radius, colors=shape.colors, labels=shape.labels or None
            )
        if isinstance(shape, Lines):
            return rr.LineStrips3D(
                list(shape.strips),
                radii=0.5 * shape.width,
                colors=np.array(shape.colors, dtype=np.uint8).reshape(-1, 3),
                labels=shape.labels or None,
            )
        if isinstance(shape, Boxes):
            return rr.Boxes3D(
                centers=shape.centers,
                sizes=shape.sizes,
                colors=np.array(shape.colors, dtype=np.uint8).reshape(-1, 3),
                labels=shape.labels,
            )
        if isinstance(shape, Value):
            return rr.Scalars(shape.value)
        assert isinstance(shape, TextNote)
        return rr.TextLog(shape.text)

    def _layout(self) -> Any:
        """The space large, numbers over time and sentences beside it."""
        import rerun.blueprint as rrb

        return rrb.Blueprint(
            rrb.Horizontal(
                rrb.Spatial3DView(origin="/map", name="map"),
                rrb.Vertical(
                    rrb.TimeSeriesView(origin="/plots", name="hypotheses, objects, people"),
                    rrb.TextLogView(origin="/log", name="why"),
                ),
                column_shares=[3, 1],
            )
        )
