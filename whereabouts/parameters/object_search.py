"""Parameters of the node `object_search`."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from estimation.geometry.places import Places
from whereabouts.parameters.parameter_base import BaseFrame, MapFrame, setting, setting_of
from world_model.tasks.relations import Relations
from world_model.tasks.search import SearchConfig

BELIEVED = 0.5
"""What less probably exists counts for nothing."""


class ObjectSearchParameters(MapFrame, BaseFrame):
    """Parameters of `object_search`."""

    public = (
        "navigate", "method", "relations_file", "places_file", "view", "arrival_distance", "learn",
        "together_distance", "rate",
    )  # fmt: skip

    navigate: bool = setting(False, "send goals to nav2's navigate_to_pose as well", fixed=True)
    method: Literal["belief", "chain"] = setting_of(SearchConfig, "method")
    relations_file: str = setting(
        "",
        "YAML file with relations between objects, or a folder of LabelMe annotations; empty: the shipped ones",
        fixed=True,
    )
    places_file: str = setting("", "YAML with rooms and furniture; empty: none", fixed=True)
    view: float = setting_of(SearchConfig, "view")
    arrival_distance: float = setting(
        0.6, "a goal counts as reached within this distance", unit="m", ge=0.05, le=10.0
    )
    learn: bool = setting(True, "refine the relations with what the world model sees together")
    together_distance: float = setting(
        3.0, "objects closer than this count as seen together", unit="m", ge=0.1, le=50.0
    )
    rate: float = setting(5.0, "decisions per second while searching", unit="Hz", ge=0.5, le=50.0)

    @property
    def search(self) -> SearchConfig:
        return self.config_of(SearchConfig)

    @property
    def relations(self) -> Relations:
        """Raises InputError naming the file and what is wrong."""
        if not self.relations_file:
            return Relations.common_sense()
        if Path(self.relations_file).is_dir():
            return Relations.from_labelme([self.relations_file], synonyms=Relations.common_sense().synonyms)
        return Relations.load(self.relations_file)

    @property
    def places(self) -> Places | None:
        """Raises InputError naming the file and what is wrong."""
        return Places.load(self.places_file) if self.places_file else None
