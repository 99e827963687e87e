"""What the suite should listen to on a robot, and which frames are whose."""

from __future__ import annotations

from dataclasses import dataclass, field

from whereabouts.messages import type_names as types
from whereabouts.node_interfaces import NODE_INTERFACES
from whereabouts.robot.preset import Preset, usual_names
from whereabouts.robot.survey import SeenTopic, Survey
from world_model.camera.depth import ENCODINGS


@dataclass
class Choice:
    """How to run the suite on a robot.

    scans, clouds, wheels : topics; the first scanner or cloud is the one that is followed. base_publishes_tf : whether
    odom_frame -> base_frame is placed by somebody else already; map_publisher : whether map -> odom is.
    namespace : that of tf, in which the nodes have to run. detector : parameters of world_model for what detects
    objects, and for its camera. preset : parameters of nodes by name.
    """

    base_frame: str = "base_link"
    odom_frame: str = "odom"
    map_frame: str = "map"
    scans: list[str] = field(default_factory=list)
    clouds: list[str] = field(default_factory=list)
    wheels: str = ""
    base_publishes_tf: bool = False
    map_published: bool = False
    sim_time: bool = False
    namespace: str = ""
    detector: dict[str, object] = field(default_factory=dict)
    preset: dict[str, dict[str, object]] = field(default_factory=dict)


def choose(survey: Survey, wanted: Preset | None = None) -> Choice:
    """Decide from what was seen; where that says nothing, `wanted` does."""
    scans, clouds = _heard_first(survey.of(types.SCAN)), _heard_first(survey.of(types.CLOUD))
    scans = _each_once(scans)
    if wanted is not None:
        scans = sorted(scans, key=lambda item: item.name not in wanted.scan_topics)
    choice = Choice(sim_time=survey.live and "/clock" in survey.topics)
    choice.preset = {name: dict(given) for name, given in wanted.parameters.items()} if wanted else {}
    followed = (scans or clouds)[:1]
    if followed:
        choice.scans = [followed[0].name] if scans else []
        choice.clouds = [] if scans else [followed[0].name]
        # Further scanners are joined to the first where tf says how they are mounted.
        tree = _tree(survey, followed[0].frame)
        joined = [item.name for item in scans[1:] if item.frame and item.frame in tree]
        choice.scans += joined
        choice.namespace = _namespace(survey, followed[0].name)
    elif wanted is not None:
        choice.scans = list(wanted.scan_topics)
    choice.wheels = _wheels(survey, wanted)
    choice.detector = _detector(survey, choice.scans)
    _frames(choice, survey, followed[0].frame if followed else "", wanted)
    return choice


def _heard_first(items: list[SeenTopic]) -> list[SeenTopic]:
    """Those that saw something before those that only said something, before those that did not; by name then."""
    return sorted(items, key=lambda item: (item.count == 0, item.blind, item.name))


def _each_once(scans: list[SeenTopic]) -> list[SeenTopic]:
    """One topic of each scanner: one that is heard before others, and what a filter has left before the raw scan."""
    order = sorted(scans, key=lambda item: (item.blind, not item.name.endswith("_filtered")))
    best = {item.frame: item.name for item in reversed(order) if item.frame}
    return [item for item in scans if not item.frame or best[item.frame] == item.name]


def _namespace(survey: Survey, followed: str) -> str:
    """The namespace of the tf that belongs to a topic."""
    known = survey.tf_namespaces()
    near = [name for name in known if followed.startswith(f"{name}/")]
    return max(near or known, key=len, default="")


def _tree(survey: Survey, frame: str) -> set[str]:
    """Frames that are connected with one, itself included."""
    found, waiting = {frame}, [frame]
    while waiting:
        here = waiting.pop()
        for edge in survey.edges:
            if here in edge:
                new = set(edge) - found
                found |= new
                waiting += new
    return found


def _wheels(survey: Survey, wanted: Preset | None) -> str:
    """The topic of wheel odometry; an Odometry topic may also be a mapper's result, or the truth."""
    known = usual_names()
    offered = [item.name for item in survey.of(types.ODOMETRY)]
    if not survey.topics and wanted is not None:
        return wanted.wheel_topic
    if wanted is not None and wanted.wheel_topic in offered:
        return wanted.wheel_topic
    for name in known.wheels:
        found = [item for item in offered if item == name] or [
            item for item in offered if item.endswith(name)
        ]
        for item in found:
            if not any(word in item.lower() for word in known.not_wheels):
                return item
    return ""


def _detector(survey: Survey, scans: list[str]) -> dict[str, object]:
    """Parameters for what detects objects, if anything does, and for the camera in whose image it does so."""
    own = {item.name for item in NODE_INTERFACES["world_model"] if item.kind == "out"}
    heard = _heard_first(survey.of(types.BOXES, types.DETECTIONS))
    found = next((item for item in heard if item.name.rpartition("/")[2] not in own), None)
    if found is None:
        return {}
    boxes = found.kind == types.BOXES
    given: dict[str, object] = {"detections_2d_topic" if boxes else "detections_topic": found.name}
    if found.rate:
        given["rate_hz"] = round(found.rate, 2)
    # A camera's depth images may have the frame of its pictures, and a camera_info of their own.
    lenses = sorted(survey.of(types.CAMERA_INFO), key=lambda item: ("depth" in item.name, item.name))
    same = [item for item in lenses if item.frame == found.frame]
    if not same and not (boxes and found.frame) and len({item.frame for item in lenses}) == 1:
        same = lenses
    if not same:
        return given
    given["camera_info_topic"] = same[0].name
    images = [
        item
        for kind in (types.IMAGE, types.COMPRESSED)
        for item in survey.of(kind)
        if item.frame == same[0].frame
    ]
    depth = next((item.name for item in images if item.encoding in ENCODINGS), "")
    if depth:
        given["depth_topic"] = depth
    elif boxes and scans:
        given |= {"depth_from_scan": True, "scan_topic": scans[0]}
    return given


def _frames(choice: Choice, survey: Survey, sensor: str, wanted: Preset | None) -> None:
    """The frame of the robot is the topmost one below what the robot moves in."""
    known = usual_names()
    sensor = sensor.lstrip("/")
    wheels = survey.topics.get(choice.wheels)
    above = {*known.above_the_robot, *([wheels.frame.lstrip("/")] if wheels is not None else [])} - {""}
    chain = survey.chain(sensor) if sensor else []
    own = [frame for frame in chain if not _is_above(frame, above)]
    if len(own) > 1 or (own and own[0] in known.robot):
        choice.base_frame = own[-1]
    elif wheels is not None and wheels.child and wheels.child == sensor:
        choice.base_frame = wheels.child
    elif sensor:
        choice.base_frame = sensor
    elif wanted is not None:
        choice.base_frame = wanted.base_frame
    parents = [name for name in survey.parents(choice.base_frame) if _is_above(name, above)]
    if parents:
        choice.odom_frame = next((name for name in parents if "odom" in name), parents[0])
        choice.base_publishes_tf = True
        over = survey.parents(choice.odom_frame)
        choice.map_published = bool(over)
        choice.map_frame = over[0] if over else choice.map_frame
    elif wanted is not None:
        choice.odom_frame = wanted.odom_frame
        choice.base_publishes_tf = wanted.base_publishes_tf and not survey.topics
    elif wheels is not None and wheels.frame.lstrip("/"):
        choice.odom_frame = wheels.frame.lstrip("/")


def _is_above(frame: str, above: set[str]) -> bool:
    """Whether the robot moves in a frame, by its name, with or without a robot's prefix."""
    return frame in above or frame.rpartition("/")[2] in above or frame.endswith(("_odom", "_map"))
