"""Parameters of the node `object_search`."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

from pydantic import create_model

from estimation.geometry.places import Places
from whereabouts.parameters.from_config import settings_of
from whereabouts.parameters.parameter_base import NodeParameters, setting
from world_model.tasks.relations import Relations
from world_model.tasks.search import SearchConfig

_WithSearch = create_model("_WithSearch", __base__=NodeParameters, **settings_of(SearchConfig))  # type: ignore[call-overload]


class ObjectSearchParameters(_WithSearch):  # type: ignore[valid-type, misc]
    """Parameters of `object_search`: its own, and all settings of `SearchConfig`."""

    public = (
        "map_frame", "base_frame", "navigate", "method", "relations_file", "places_file", "view", "arrival_distance",
        "threshold", "learn", "rate",
    )  # fmt: skip

    map_frame: str = setting("map", "frame of the world state, the map and the goals", fixed=True)
    base_frame: str = setting("base_link", "frame of the robot", fixed=True)
    relations_file: str = setting(
        "",
        "YAML file with relations between objects, or a folder of LabelMe annotations; empty: the shipped ones",
        fixed=True,
    )
    places_file: str = setting("", "YAML with rooms and furniture; empty: none", fixed=True)
    arrival_distance: float = setting(
        0.6, "a goal counts as reached within this distance", unit="m", ge=0.05, le=10.0
    )
    belief: float = setting(0.5, "objects less probable to exist than this are ignored", ge=0.0, le=1.0)
    learn: bool = setting(True, "refine the relations with what the world model sees together")
    together_distance: float = setting(
        3.0, "objects closer than this count as seen together", unit="m", ge=0.1, le=50.0
    )
    navigate: bool = setting(False, "send goals to nav2's navigate_to_pose as well", fixed=True)
    rate: float = setting(5.0, "decisions per second while searching", unit="Hz", ge=0.5, le=50.0)

    @property
    def search(self) -> SearchConfig:
        """The library's settings."""
        return SearchConfig(**{item.name: getattr(self, item.name) for item in fields(SearchConfig)})

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
