"""Node `motion_predictor`: learns where people go and predicts the paths of all who are there."""

from __future__ import annotations

import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from nav_msgs.msg import OccupancyGrid
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from estimation.checks import FloatArray as Array
from estimation.errors import InputError
from estimation.geometry.frame_tree import TransformError
from tracking.intentions import IntentionModel, Prediction
from tracking.intentions.intention_storage import is_saved_model
from tracking.intentions.tracks import TrackKeeper
from tracking.prediction.social_forces import Obstacles
from whereabouts.nodes.messages.conversions import cloud_message
from whereabouts.nodes.messages.intention_messages import (
    PathMarkers,
    markers_message,
    occupancy_points,
    occupied_points,
    paths_message,
    people_from_message,
)
from whereabouts.nodes.messages.stamps import NANOSECONDS, time_message
from whereabouts.nodes.messages.transforms import check_frame, frame_name
from whereabouts.nodes.navigation.keepout_mask import PeopleMask
from whereabouts.nodes.ros.base import SuiteNode, exit_with
from whereabouts.nodes.ros.diagnostics import Health
from whereabouts.nodes.ros.qos import EVENTS, LATCHED
from whereabouts.parameters.motion_predictor import MotionPredictorParameters
from whereabouts.system.counting import counted
from whereabouts.system.state_files import keep_foreign
from whereabouts_msgs.msg import PredictedPathArray, TargetArray
from whereabouts_msgs.srv import LoadState, Reset, SaveState

TRACK_TIMEOUT = 2.0  # seconds without an observation after which a track has ended, and is learned
PERSON_PROBABILITY = 0.3  # what is less probably a person is left out
POINT_INTERVAL = 0.5  # seconds between published points of a path
OCCUPANCY_HEIGHT = 0.5  # metres, of the occupied points
MASK_PERIOD = 1.0  # seconds between masks at least; nav2 warns of each in its log


class MotionPredictorNode(SuiteNode):
    """Intentions learned from tracks that ended, paths for tracks that go on."""

    parameters_model = MotionPredictorParameters
    node_name = "motion_predictor"
    settings: MotionPredictorParameters

    def setup(self) -> None:
        settings = self.settings
        self._restart()
        self.listen_to_transforms(on_demand=True)
        self.add_input(OccupancyGrid, "map", self._take_map, qos=LATCHED, sensor=False)
        self.add_input(TargetArray, "targets", self._take_targets, frames=self._frames, qos=EVENTS)
        self._obstacles = Obstacles()
        self._paths_output = self.add_output(PredictedPathArray, "predicted_paths")
        self._markers_output = self.add_output(MarkerArray, "~/markers")
        self._occupancy_output = self.add_output(PointCloud2, "predicted_occupancy")
        self._mask = PeopleMask(self) if settings.publish_mask else None
        if self._mask is not None:
            self.add_timer(MASK_PERIOD, self._send_mask)
        self.add_service(SaveState, "~/save", self._save)
        self.add_service(LoadState, "~/load", self._load)

    def start_run(self) -> None:
        """Who was there is forgotten; what was learned stays."""
        self._tracks = TrackKeeper(TRACK_TIMEOUT)
        self._predicted_at: int | None = None
        self._milliseconds = 0.0
        self._predictions: dict[int, Prediction] = {}
        if self._mask is not None:
            self._mask.forget()

    def health(self) -> Health:
        model = self._model
        figures: dict[str, object] = {
            "present": len(self._tracks),
            "learned": model.learned,
            "predicted": len(self._predictions),
            "prediction ms": round(self._milliseconds, 2),
            "obstacle points": len(self._obstacles),
        }
        if self._predictions:
            figures["novelty"] = round(float(np.mean([p.novelty for p in self._predictions.values()])), 3)
        figures |= {f"not learned, {reason}": count for reason, count in sorted(self._refused.items())}
        figures |= {f"left out, {reason}": count for reason, count in sorted(self._dropped.items())}
        return Health("predicting" if self._predictions else "waiting for people", figures=figures)

    def _restart(self) -> None:
        """What a restarted node knows: the saved model where there is one, otherwise nothing."""
        settings = self.settings
        self._refused: Counter[str] = Counter()
        self._dropped: Counter[str] = Counter()
        self._model = IntentionModel.of(settings.intentions)
        if settings.model_path and Path(settings.model_path).exists():
            self._adopt(Path(settings.model_path))
        self._model.warm_up()

    def _adopt(self, path: Path) -> None:
        loaded = IntentionModel.load(path, self.settings.map_id)
        if loaded.config.method != self.settings.method:
            raise InputError(
                f"{path}: the model was learned with method {loaded.config.method!r}, not {self.settings.method!r}"
            )
        self._model = loaded

    def _frames(self, message: TargetArray) -> list[tuple[str, str]]:
        return [(self.settings.map_frame, message.header.frame_id)]

    def _take_map(self, message: OccupancyGrid, _: int) -> None:
        check_frame("map", message.header.frame_id, self.settings.map_frame)
        self._obstacles = Obstacles(occupied_points(message))
        if self._mask is not None:
            self._mask.map = message.info

    def _take_targets(self, message: TargetArray, stamp: int) -> None:
        settings = self.settings
        transform = self.transforms.lookup(settings.map_frame, message.header.frame_id, stamp)
        people, hidden = people_from_message(message, PERSON_PROBABILITY, transform)
        for track in self._tracks.observe(stamp / NANOSECONDS, people, hidden):
            if settings.learn:
                outcome = self._model.learn(track)
                self._dropped.update(outcome.dropped)
                if not outcome.taken:
                    self._refused[outcome.reason] += 1
        last = self._predicted_at
        # A little early counts, so that jitter of the stamps does not halve the rate.
        if last is None or not 0 <= stamp - last < 0.95 * NANOSECONDS / settings.rate:
            self._predicted_at = stamp
            self._predict(stamp)

    def _predict(self, stamp: int) -> None:
        settings = self.settings
        tracks = self._tracks.present()
        begun = time.perf_counter()
        now = stamp / NANOSECONDS
        # Where nobody is in view, the prediction starts when somebody last was, and must reach as far.
        late = max(now - max((float(rows[-1, 2]) for rows in tracks.values()), default=now), 0.0)
        told = self._model.predict_all(list(tracks.values()), settings.horizon + late, self._obstacles)
        self._predictions = dict(zip(tracks, told, strict=True))
        self._milliseconds = 1e3 * (time.perf_counter() - begun)
        header = Header(stamp=time_message(stamp), frame_id=frame_name(settings.map_frame))
        self._paths_output.publish(paths_message(header, self._predictions, settings.horizon, POINT_INTERVAL))
        if self._markers_output.wanted:
            self._markers_output.publish(markers_message(header, self._predictions))
        if self._occupancy_output.wanted:
            points = occupancy_points(
                self._predictions, now, self._ways, self._model.config.radius, OCCUPANCY_HEIGHT
            )
            self._occupancy_output.publish(self._from_robot(points, stamp))
        if self._mask is not None:
            self._mask.hear(self._predictions, now)

    @property
    def _ways(self) -> PathMarkers:
        """What of the predictions costmaps are told."""
        settings = self.settings
        return PathMarkers(settings.occupancy_horizon, POINT_INTERVAL / 2.0, settings.occupancy_probability)

    def _send_mask(self) -> None:
        settings = self.settings
        assert self._mask is not None
        header = Header(stamp=time_message(self.now), frame_id=frame_name(settings.map_frame))
        self._mask.send(header, self._ways, settings.mask_radius)

    def _from_robot(self, points: Array, stamp: int) -> PointCloud2:
        """Points (M, 3) of the map as a cloud that is centred on the robot, where tf knows it.

        Costmaps measure how far an obstacle is from the origin of its cloud, and leave out what is farther than a
        sensor sees: of a cloud in the map's frame all but what is near its origin.
        """
        place = frame_name(self.settings.map_frame)
        base = frame_name(self.settings.base_frame)
        newest = self.transforms.newest(base, place)
        at = stamp if not newest else min(stamp, newest)
        try:
            robot = self.transforms.lookup(base, place, at)
        except TransformError:
            return cloud_message(Header(stamp=time_message(stamp), frame_id=place), points)
        seen = points @ robot[:3, :3].T + robot[:3, 3]
        return cloud_message(Header(stamp=time_message(at), frame_id=base), seen)

    def _reset(self, request: Reset.Request, response: Reset.Response) -> str:
        self._restart()
        return super()._reset(request, response)

    def _save(self, request: SaveState.Request, response: SaveState.Response) -> str:
        path = self._path(request, making=True)
        keep_foreign(path, is_saved_model, "a saved intention model")
        response.path = str(self._model.save(path, self.settings.map_id))
        return f"{self._learned()} saved"

    def _learned(self) -> str:
        return counted(self._model.learned, "trajectory", "trajectories")

    def _load(self, request: LoadState.Request, _: LoadState.Response) -> str:
        self._adopt(self._path(request))
        return f"{self._learned()} loaded"

    def _path(self, request: Any, making: bool = False) -> Path:
        return self.settings.files.named(request.path, self.settings.model_path, making)


def main() -> None:
    exit_with(MotionPredictorNode)


if __name__ == "__main__":
    main()
