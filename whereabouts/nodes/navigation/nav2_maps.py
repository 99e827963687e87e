"""The map by the names of nav2's map_saver, map_server and amcl, for what calls these; two of them need nav2_msgs."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from typing import Any
from urllib.parse import unquote

from nav_msgs.srv import GetMap
from std_srvs.srv import Empty

from estimation.errors import InputError
from whereabouts.nodes.mapping.map_files import MapFiles
from whereabouts.nodes.mapping.map_publisher import MapPublisher
from whereabouts.nodes.ros.base import SuiteNode


class Nav2Maps:
    """nav2's services of a map; files are named as in the node's own services, and as safe.

    look_anew : looks for the robot in the whole map.
    """

    def __init__(
        self, node: SuiteNode, files: MapFiles, publisher: MapPublisher, look_anew: Callable[[], None]
    ) -> None:
        self._node, self._files, self._publisher, self._look_anew = node, files, publisher, look_anew
        node.add_service(GetMap, "map_server/map", self._get)
        node.add_service(Empty, "reinitialize_global_localization", self._look)
        try:
            types = import_module("nav2_msgs.srv")
            offered = (
                (types.SaveMap, "map_saver/save_map", self._save),
                (types.LoadMap, "map_server/load_map", self._load),
            )
        except (ImportError, AttributeError):
            node.get_logger().info(
                "nav2_msgs is not installed: no map_saver/save_map, no map_server/load_map"
            )
            return
        for kind, name, answer in offered:
            node.add_service(kind, name, answer)

    def _get(self, _: GetMap.Request, response: GetMap.Response) -> None:
        response.map = self._publisher.message()

    def _look(self, _request: Empty.Request, _: Empty.Response) -> None:
        self._look_anew()

    def _save(self, request: Any, response: Any) -> None:
        topics = [self._node.resolve_topic_name(name) for name in (request.map_topic or "map", "map")]
        if topics[0] != topics[1]:
            raise InputError(f"map_topic: {topics[1]} expected, got {topics[0]}")
        # The file says which grey means what, so that thresholds are checked and not used.
        occupied, free = request.occupied_thresh or 0.65, request.free_thresh or 0.25
        if not 0.0 < free < occupied <= 1.0:
            raise InputError(
                f"0 < free_thresh < occupied_thresh <= 1 expected, got {free:g} and {occupied:g}"
            )
        for name, value, known in (
            ("image_format", request.image_format.lower(), "pgm"),
            ("map_mode", request.map_mode.lower(), "trinary"),
        ):
            if value not in ("", known):
                raise InputError(f"{name}: {known} expected, got {value!r}")
        written = self._files.save_map(self._files.named(file_of(request.map_url), making=True))
        self._node.get_logger().info(f"map_saver/save_map: {written}, with .pgm and .yaml")
        response.result = True

    def _load(self, request: Any, response: Any) -> None:
        stem = self._files.named(file_of(request.map_url))
        graph, described = (stem.with_name(f"{stem.name}{ending}") for ending in (".npz", ".yaml"))
        if not graph.exists():
            found = described.exists()
            response.result = (
                response.RESULT_INVALID_MAP_DATA if found else response.RESULT_MAP_DOES_NOT_EXIST
            )
            beside = "; an image alone is no map to be found in" if found else ""
            self._complain(f"{graph} is missing{beside}")
            return
        try:
            self._files.load_map(stem, self._node.settings.localization_only)
        except InputError as error:
            response.result = response.RESULT_INVALID_MAP_DATA
            self._complain(str(error))
            return
        response.result = response.RESULT_SUCCESS
        with suppress(InputError):  # there is no image of clouds
            response.map = self._publisher.message()

    def _complain(self, problem: str) -> None:
        self._node.complain(f"service map_server/load_map: {problem}", key=("load_map", problem))


def file_of(url: str) -> str:
    """The path in a `file:` URL; what has no scheme is a path itself. Raises InputError for other schemes."""
    scheme, separator, rest = url.partition("://")
    if not separator:
        return url
    if scheme != "file" or not rest.startswith("/"):
        raise InputError(f"map_url: a name or file:///PATH expected, got {url!r}")
    return unquote(rest)
