"""The files of a node's map: `~/save_map`, `~/load_map`, and what is written now and then."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from estimation.checks import FloatArray as Array
from estimation.errors import InputError
from estimation.geometry.grid import is_grid_file
from loop_closure.maps.map_file import is_map, write_map
from whereabouts.nodes.mapping.map_in_use import MapInUse
from whereabouts.nodes.messages.conversions import PLANAR, pose_from_message
from whereabouts.nodes.messages.transforms import check_frame
from whereabouts.nodes.ros.base import SuiteNode
from whereabouts.system.atomic import atomic_path
from whereabouts.system.counting import counted
from whereabouts.system.state_files import keep_foreign
from whereabouts_msgs.srv import LoadMap, SaveMap


class MapFiles:
    """Writes and reads a map. finish : does all that scans have left over."""

    def __init__(self, node: SuiteNode, made: MapInUse, finish: Callable[[], None]) -> None:
        self._node, self._map, self._finish = node, made, finish
        node.add_service(SaveMap, "~/save_map", self._save)
        node.add_service(LoadMap, "~/load_map", self._load)

    def save_regularly(self) -> None:
        # What is saved is not lost to the little that is known after a jump of time.
        if len(self._map.slam.keyframes) and self._map.localizer is None and self._map.earlier is None:
            self._write(Path(self._node.settings.map_file))

    def _save(self, request: SaveMap.Request, response: SaveMap.Response) -> str:
        response.path = str(self.save_map(self.named(request.path, making=True)))
        return f"{counted(len(self._map.slam.keyframes), 'keyframe')} written"

    def save_map(self, stem: Path) -> Path:
        """Write the map's files. Raises InputError where there is no map, or a file is foreign."""
        if not len(self._map.slam.keyframes):
            raise InputError("there is no map yet")
        return self._write(stem)

    def load_map(self, stem: Path, localization_only: bool, initial: Array | None = None) -> int:
        """Take a saved map, see `MapInUse.begin_with`; returns how many keyframes it has. Raises InputError."""
        return self._map.begin_with(stem.with_name(f"{stem.name}.npz"), localization_only, initial)

    def _write(self, stem: Path) -> Path:
        """Each file appears whole; what is there already stays until then."""
        target = stem.with_name(stem.name + ".npz")
        keep_foreign(target, is_map, "a map of the suite")
        for suffix in (".pgm", ".yaml"):
            keep_foreign(stem.with_name(stem.name + suffix), is_grid_file, "a map of the suite")
        self._finish()
        if self._map.flat:
            self._map.grid.update(self._map.slam)
            self._map.grid.bounded(warn=self._node.complain).save(stem, _replace)
        with atomic_path(target) as temporary, temporary.open("wb") as file:
            write_map(self._map.slam, file)
        return target

    def _load(self, request: LoadMap.Request, _: LoadMap.Response) -> str:
        initial: Array | None = None
        frame = request.initial_pose.header.frame_id
        if frame:
            check_frame("initial_pose", frame, self._node.settings.map_frame)
            initial = pose_from_message(request.initial_pose.pose)[PLANAR]
        count = self.load_map(self.named(request.path), request.localization_only, initial)
        return f"{counted(count, 'keyframe')} read"

    def named(self, name: str, making: bool = False) -> Path:
        """Stem of the files that a request names. Raises InputError for what requests may not name."""
        settings = self._node.settings
        if name and name != settings.map_file:
            name = f"{_stem(name)}.npz"
        return _stem(str(settings.files.named(name, settings.map_file, making)))


def _stem(name: str) -> Path:
    """Path without the ending a map's files may have been named with."""
    path = Path(name)
    return path.with_suffix("") if path.suffix in (".npz", ".pgm", ".yaml") else path


def _replace(path: Path, data: bytes) -> None:
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)
