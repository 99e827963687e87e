"""Node `world_model`: which objects exist and where they are, with a memory."""

from __future__ import annotations

import time
from collections import deque

import numpy as np
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from vision_msgs.msg import Detection2DArray, Detection3DArray

from whereabouts.nodes.messages.stamps import NANOSECONDS
from whereabouts.nodes.messages.transforms import check_frame, frame_name
from whereabouts.nodes.messages.world_reading import paths_from_message
from whereabouts.nodes.ros.base import SuiteNode, exit_with
from whereabouts.nodes.ros.diagnostics import Health
from whereabouts.nodes.ros.qos import EVENTS
from whereabouts.nodes.world.camera_door import CameraDoor
from whereabouts.nodes.world.seen_frames import SeenFrames
from whereabouts.nodes.world.world_publisher import WorldPublisher
from whereabouts.nodes.world.world_services import WorldServices
from whereabouts.parameters.world_model import WorldModelParameters
from whereabouts.recorded.evidence_messages import PERSON, Reader, most_probably
from whereabouts.system.counting import counted
from whereabouts_msgs.msg import PredictedPathArray, TargetArray
from whereabouts_msgs.msg import WorldEvidence as EvidenceMessage
from world_model import ObjectEvidence, WorldEvidence, WorldModel, WorldState
from world_model.memory.store import RETRY, Store
from world_model.predictions import Path
from world_model.queries import Words

# A target this far from where its object was is somebody else: m, and m/s since.
HINT_DISTANCE, WALKING_SPEED = 1.0, 2.0
# Targets are filtered: those in between, s, are not independent.
TARGET_PERIOD = 0.5


class WorldModelNode(SuiteNode):
    """Objects and their symbols, from detections."""

    parameters_model = WorldModelParameters
    node_name = "world_model"
    settings: WorldModelParameters
    _model: WorldModel | None = None
    _configured = False

    def setup(self) -> None:
        settings = self.settings
        config, symbols = settings.world, settings.symbols
        places = settings.places
        map_frame = frame_name(settings.map_frame)
        if places:
            check_frame("places_file", places.frame, map_frame)
        store = Store(settings.store_path) if settings.store_path else None
        # Nobody asks the node to look back.
        self._model = WorldModel(config, places, store, looks_back=False)
        self.created.callback(self._close)
        if store is not None:
            store.watch()
            self.add_timer(RETRY, self._write_again)
        self._model.words = Words(places, symbols)
        self._damages_told = 0
        self._report_store()
        known = {"class": config.classes, "color": config.colors}
        names, numbers = (*known, *config.attributes), tuple(config.quantities)
        self._reader = Reader(known, names, config.measurement_sigma, symbols, numbers)
        self.listen_to_transforms(on_demand=True)
        self._seen = SeenFrames(self, map_frame)
        self.add_input(
            EvidenceMessage,
            "evidence",
            self._take_evidence,
            frames=self._seen.wanted,
            qos=EVENTS,
        )
        self.camera = CameraDoor(self, map_frame, store, self._take_boxes, self._take_detections)
        self.add_input(TargetArray, "targets", self._take_targets, frames=self._seen.wanted, qos=EVENTS)
        # A prediction reaches ahead: what it is made of may be older than what other inputs have brought.
        self.add_input(
            PredictedPathArray, "predicted_paths", self._take_paths, frames=self._seen.wanted, sensor=False
        )
        self._output = WorldPublisher(self, map_frame, self._model)
        WorldServices(self, self._output, self.camera)

    def start_run(self) -> None:
        if self._configured:
            self.model.reset()
        elif np.isfinite(self.model.stamp):
            # What is remembered says when it was; one message that is far from that does not age it.
            self.time.begin(round(self.model.stamp * NANOSECONDS))
        self._configured = True
        self._forget_live()

    def next_run(self) -> None:
        """The world stays, as it was known in the run before."""
        self.model.next_run()
        self._forget_live()

    def _forget_live(self) -> None:
        self._seen.pose = None
        self._output.begin()
        self._updates = 0
        self._durations: deque[float] = deque(maxlen=500)
        self._targets_at: int | None = None
        self._target_ids: dict[int, str] = {}
        self._predictions: dict[str, Path] = {}
        self.camera.reset()
        self._left_out = 0
        self._refused = self._outside = 0

    @property
    def model(self) -> WorldModel:
        """The world model, from configuration to clean-up."""
        assert self._model is not None
        return self._model

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        result = super().on_activate(state)
        if self.active and np.isfinite(self.model.stamp):
            # What was remembered is known before anything is seen.
            self._output.send(self._output.now_known(), round(self.model.stamp * NANOSECONDS))
        return result

    def _close(self) -> None:
        if self._configured:
            self.camera.keep(self._output.stamp, now=True)
        self.model.close()
        self._model, self._configured = None, False

    def health(self) -> Health:
        if self._model is None:
            return Health("not configured")
        health = self._model.health
        held = counted(int(health["objects"]), "object")
        figures: dict[str, object] = dict(health)
        figures["run"] = self._model.epoch
        figures["objects not seen in this run"] = self._model.of_earlier_runs
        figures["updates"] = self._updates
        figures["people in other evidence, ignored"] = self._left_out
        figures["detections with unknown words, ignored"] = self._refused
        figures["detections far from the region"] = self._outside
        if self.camera.cameras.lenses:
            figures["detections without a place, ignored"] = self.camera.unplaced
            figures["looks without depth, absence not counted"] = self.camera.without_depth
            figures |= self.camera.rates.figures()
        if self._durations:
            p50, p99 = np.percentile(self._durations, [50, 99]) * 1e3
            figures |= {"update p50 [ms]": float(p50), "update p99 [ms]": float(p99)}
        store = self._model.store
        if store is None:
            return Health(f"{held}, not remembered", figures=figures)
        figures |= {
            "history rows": store.rows,
            "failed writes": store.failures,
            "damages": len(store.damages),
        }
        keeper = store.keeper
        if keeper is not None:
            figures |= {"checks of the store": keeper.checks, "snapshots": keeper.snapshots}
        trouble = (
            store.problem
            or self._model.household.kept.problem
            or self.camera.kept.problem
            or (keeper.problem if keeper is not None else "")
        )
        if trouble or store.damages:
            return Health(trouble or store.damages[-1], warning=True, figures=figures)
        return Health(held, figures=figures)

    # Evidence.

    def _take_evidence(self, message: EvidenceMessage, stamp: int) -> None:
        evidence, missing = self._reader.evidence(message, self._seen.of(message, stamp))
        evidence = self._of_things(evidence)
        if evidence.objects or evidence.sensor is not None or not missing:
            self._update(evidence, stamp)
        for object_id in missing:
            self._output.send(self.model.report(object_id, "not_found", stamp / NANOSECONDS), stamp)

    def _take_detections(self, message: Detection3DArray, stamp: int) -> None:
        evidence = self._reader.detections(message, self._seen.of(message, stamp))
        lens = self.camera.lens_of(message, of_image=False)
        if lens is not None:
            evidence.view = self.camera.view(lens, stamp, self._seen.at(lens[0], stamp))
            evidence.blocked = self.camera.says_nothing(evidence.view, stamp, lens[0])
        self._update(self._of_things(evidence), stamp)

    def _take_boxes(self, message: Detection2DArray, stamp: int) -> None:
        lens = self.camera.lens_of(message, of_image=True)
        assert lens is not None
        frame = self._seen.at(lens[0], stamp)
        view = self.camera.view(lens, stamp, frame)
        evidence, refused = self._reader.boxes(message, frame, view, self.camera.placing(view))
        for reason in refused:
            self.complain(f"a detection has no place and is ignored: {reason}", key="boxes")
        self.camera.unplaced += len(refused)
        evidence.blocked = self.camera.says_nothing(view, stamp, lens[0])
        self._update(self._of_things(evidence), stamp)

    def _take_targets(self, message: TargetArray, stamp: int) -> None:
        since = None if self._targets_at is None else (stamp - self._targets_at) / NANOSECONDS
        if since is not None and 0.0 <= since < TARGET_PERIOD:
            return
        evidence, labels = self._reader.targets(message, self._seen.of(message, stamp), self._target_ids)
        evidence, refused = self._usable(evidence)
        labels = [label for index, label in enumerate(labels) if index not in refused]
        for item in evidence.objects:
            if item.object_id is not None and not self._plausible(item, stamp):
                item.object_id = None
        self._targets_at = stamp
        state = self._update(evidence, stamp)
        present = {int(target.label) for target in message.targets}
        kept = {label: name for label, name in self._target_ids.items() if label in present}
        found = zip(labels, state.associations, strict=True)
        self._target_ids = kept | {label: name for label, name in found if name is not None}

    def _take_paths(self, message: PredictedPathArray, stamp: int) -> None:
        """Where people will be who are not seen; counts from the next evidence on."""
        there = self._seen.lookup(message, stamp)
        for label, path in paths_from_message(message, there).items():
            name = self._target_ids.get(label)
            if name is not None:
                self._predictions[name] = path

    def _plausible(self, item: ObjectEvidence, stamp: int) -> bool:
        """Whether a target can be the object its label was before: labels are mixed up now and then."""
        known = next((other for other in self._output.shown if other.id == item.object_id), None)
        if known is None or known.lost:
            return False
        since = max((stamp - self._output.stamp) / NANOSECONDS, 0.0)
        apart = float(np.hypot(*(np.asarray(item.position) - known.position)[:2]))
        return apart < HINT_DISTANCE + WALKING_SPEED * since

    def _of_things(self, evidence: WorldEvidence) -> WorldEvidence:
        """What is usable, without people where these come by another topic."""
        if self._targets_at is not None:
            kept = [item for item in evidence.objects if not most_probably(item, PERSON)]
            self._left_out += len(evidence.objects) - len(kept)
            evidence.objects = kept
        evidence, _ = self._usable(evidence)
        outside = self.model.outside(evidence)
        self._outside += len(outside)
        for x, y, z in outside:
            self.complain(
                f"a detection at {x:.1f}, {y:.1f}, {z:.1f} m is far from the parameter region: are its unit, its frame "
                "and the region right?",
                key="region",
            )
        return evidence

    def _usable(self, evidence: WorldEvidence) -> tuple[WorldEvidence, dict[int, str]]:
        """Without detections of classes or attributes that nobody knows: these are said and counted.

        Of those in a view, what known objects they may be of still counts.
        """
        kept, refused = self.model.usable(evidence, wordless=evidence.view is not None)
        self._refused += len(refused)
        for reason in refused.values():
            self.complain(f"a detection is ignored: {reason}", key="words")
        return kept, refused

    def _update(self, evidence: WorldEvidence, stamp: int) -> WorldState:
        behind = self.model.stamp - stamp / NANOSECONDS
        if behind > self.model.config.late_window:
            self.begin_run(f"the remembered world is {behind:.3f} s newer than this message")
        begun = time.perf_counter()
        predictions, self._predictions = self._predictions, {}
        state = self.model.update(evidence, stamp / NANOSECONDS, predictions)
        self._durations.append(time.perf_counter() - begun)
        self._updates += 1
        self._report_store()
        self._output.send(state, stamp)
        return state

    def _write_again(self) -> None:
        """What the disk did not take is written while nothing new comes, too."""
        if self.model.store is not None and self.model.store.problem:
            self.model.store.retry()

    def _report_store(self) -> None:
        store = self.model.store
        if store is None:
            return
        if store.problem:
            self.complain(store.problem, key="store")
        for damage in store.damages[self._damages_told :]:
            self.complain(damage, key=damage)
        self._damages_told = len(store.damages)


def main() -> None:
    exit_with(WorldModelNode)


if __name__ == "__main__":
    main()
