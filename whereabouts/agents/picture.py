"""The world as a picture: rooms, furniture, and where objects are."""

from __future__ import annotations

from io import BytesIO

from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from world_model.questions import Recall
from world_model.questions.answers import clean, clock
from world_model.questions.naming import name_of

SIZE, DPI = 8.0, 110


def map_picture(world: Recall) -> bytes:
    """PNG of the home from above, in m; objects that are missing are left out."""
    figure = Figure(figsize=(SIZE, SIZE), dpi=DPI, layout="constrained")
    axes = figure.add_subplot()
    for place in world.places:
        room = place.kind == "room"
        color = "#f4f1ea" if room else "#d9c9a8"
        axes.add_patch(Polygon(place.polygon, facecolor=color, edgecolor="#777777", zorder=1 + (not room)))
        x, y = place.center
        axes.text(x, y, name_of(place.name), ha="center", va="center", size=8, color="#666666", zorder=3)
    for item in world.present.values():
        if item.lost or item.existence < 0.5:
            continue
        x, y, _ = item.position
        axes.plot(x, y, "o", color="#c0392b", zorder=4)
        axes.annotate(
            clean(item.id), (x, y), (4, 4), textcoords="offset points", size=8, zorder=5, parse_math=False
        )
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set_xlabel("x, m")
    axes.set_ylabel("y, m")
    axes.set_title(clock(world.now))
    drawn = BytesIO()
    figure.savefig(drawn, format="png")
    return drawn.getvalue()
