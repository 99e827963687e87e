"""What others ask of `world_model`, and how they correct it: `~/query`, `~/forget`, `~/relabel`, `~/save`."""

from __future__ import annotations

import numpy as np
from std_msgs.msg import Header

from estimation.checks import FloatArray as Array
from estimation.errors import InputError
from whereabouts.nodes.messages.stamps import NANOSECONDS, nanoseconds, time_message
from whereabouts.nodes.messages.transforms import frame_name
from whereabouts.nodes.messages.world_messages import object_message, region_from_message
from whereabouts.nodes.ros.base import SuiteNode
from whereabouts.nodes.world.camera_door import CameraDoor
from whereabouts.nodes.world.world_publisher import WorldPublisher
from whereabouts.system.counting import counted
from whereabouts_msgs.srv import ForgetObject, QueryWorld, RelabelObject, SaveState
from world_model.camera.rates import SUFFIX as CAMERA_SUFFIX
from world_model.model import routines_path


class WorldServices:
    """Services of a node over the world that it publishes."""

    def __init__(self, node: SuiteNode, world: WorldPublisher, camera: CameraDoor) -> None:
        self._node, self._world, self._camera = node, world, camera
        node.add_service(QueryWorld, "~/query", self._query)
        node.add_service(ForgetObject, "~/forget", self._forget)
        node.add_service(RelabelObject, "~/relabel", self._relabel)
        node.add_service(SaveState, "~/save", self._save)

    def _query(self, request: QueryWorld.Request, response: QueryWorld.Response) -> str:
        moment = nanoseconds(request.time)
        frame = frame_name(request.frame_id) or self._world.map_frame
        there = self._node.transforms.lookup(self._world.map_frame, frame, self._world.stamp)
        answers = self._world.model.query(
            class_name=request.class_name,
            predicate=list(request.predicates),
            object_id=request.object_id,
            region=region_from_message(request.region, there),
            stamp=moment / NANOSECONDS if moment else None,
            min_probability=request.min_probability,
            limit=int(request.limit) or None,
        )
        back: Array = np.asarray(np.linalg.inv(there), dtype=np.float64)
        stamp = time_message(max(moment or self._world.stamp, 0))
        response.world.header = Header(stamp=stamp, frame_id=frame)
        response.world.objects = [object_message(answer.object, back) for answer in answers]
        response.world.epoch = self._world.model.epoch
        response.probabilities = [min(answer.probability, 1.0) for answer in answers]
        response.descriptions = [answer.description for answer in answers]
        if request.object_id and answers and not moment:
            routine = self._world.model.explain(request.object_id)
            response.descriptions[0] += f". {routine}" if routine else ""
        return counted(len(answers), "object")

    def _forget(self, request: ForgetObject.Request, response: ForgetObject.Response) -> str:
        if not request.object_id and not request.class_name:
            raise InputError("object_id and class_name are both empty: nothing to forget")
        names = [request.object_id] if request.object_id else []
        if request.class_name:
            names += [
                item.id
                for item in self._world.now_known().objects
                if item.most_probable("class") == request.class_name and item.id not in names
            ]
        for name in names:
            self._world.model.forget(name)
            response.object_ids.append(name)
        self._world.after_change()
        return f"{counted(len(names), 'object')} forgotten"

    def _relabel(self, request: RelabelObject.Request, _: RelabelObject.Response) -> str:
        if not request.class_name and not request.new_object_id:
            raise InputError("class_name and new_object_id are both empty: nothing to change")
        self._world.model.relabel(request.object_id, request.class_name, request.new_object_id)
        self._world.after_change()
        return "relabelled"

    def _save(self, request: SaveState.Request, response: SaveState.Response) -> str:
        store = self._world.model.store
        if store is None:
            raise InputError("there is no store: the parameter store_path is empty")
        settings = self._node.settings
        path = store.save(settings.files.named(request.path, settings.store_path, making=True))
        self._world.model.household.write(routines_path(path))
        self._camera.rates.write(path.with_name(path.name + CAMERA_SUFFIX))
        response.path = str(path)
        return "written"
