"""What stands in the way of running the suite on a robot, each with what to do about it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from registration.laser.mounting import level_pose
from whereabouts.messages.type_names import CLOUD, IMU, ODOMETRY, SCAN, TF
from whereabouts.robot.choice import Choice
from whereabouts.robot.survey import CAMERAS, UNTAKEN, Survey, names
from whereabouts.system.counting import counted

# s between the clocks of two sources: a transform is then looked up at a wrong time, or is not there at all.
APART, FAR_APART = 0.5, 5.0
FAR = 500.0  # m, farther than any planar scanner sees
Level = Literal["error", "warning", "note"]
USED = (SCAN, CLOUD, ODOMETRY, TF)


@dataclass(frozen=True)
class Finding:
    """One sentence about a robot. error : the suite would not work, or would break what works."""

    level: Level
    text: str

    def __str__(self) -> str:
        return f"{self.level}: {self.text}"


error = partial(Finding, "error")
warning = partial(Finding, "warning")
note = partial(Finding, "note")


def findings(survey: Survey, choice: Choice) -> list[Finding]:
    """All there is to say, the gravest first."""
    parts = (
        _sensors, _refused, _namespaces, _tree, _mounting, _publishers, _clocks, _qos, _odometry, _objects, _others
    )  # fmt: skip
    said = [finding for part in parts for finding in part(survey, choice)]
    return sorted(said, key=lambda finding: ("error", "warning", "note").index(finding.level))


def _sensors(survey: Survey, choice: Choice) -> Iterator[Finding]:
    scans, clouds = survey.of(SCAN), survey.of(CLOUD)
    if not scans and not clouds:
        yield error(f"{survey.source} has neither LaserScan nor PointCloud2 messages")
        for other in survey.of(*UNTAKEN):
            yield error(f"{other.name} is a {other.kind.rpartition('/')[2]}: {UNTAKEN[other.kind]}")
        return
    followed = (choice.scans or choice.clouds)[0]
    for item in [*scans, *clouds]:
        if item.count == 0:
            # Nothing is known of a sensor that is silent: neither its frame nor whether its stamps are right.
            yield Finding(
                "error" if item.name == followed else "warning",
                f"{item.name}: no message came within {survey.seconds:.0f} s",
            )
        elif item.unstamped:
            yield error(f"{item.name}: its stamps are all 0: the driver has to set header.stamp")
        elif item.blind and not item.refused:
            yield warning(
                f"{item.name}: none of {item.count} scans has a reading between range_min and range_max, which are in "
                "metres"
            )
        elif item.range_max and FAR < item.range_max < np.inf:
            yield warning(
                f"{item.name}: its range_max is {item.range_max:g} m: are its ranges in millimetres?"
            )
        elif not item.frame:
            yield error(f"{item.name}: its frame_id is empty: set it in the driver")
        elif item.frame.startswith("/"):
            yield note(f"{item.name}: frame '{item.frame}' has a leading slash, which is ignored")
    item = survey.topics[followed]
    reach = f", up to {item.range_max:g} m" if item.range_max else ""
    rate = f" at {item.rate:.1f} Hz" if item.rate else ""
    joined = f", joined with {', '.join(choice.scans[1:])}" if choice.scans[1:] else ""
    yield note(f"following {followed}{rate}{reach}{joined}")
    beside = [other for other in scans if other.name not in choice.scans]
    taken = {survey.topics[name].frame for name in choice.scans}
    same = [other for other in beside if other.frame in taken]
    if same:
        yield note(f"not used: {names(same)}: of the same scanner as a scan that is followed")
    apart = [other for other in beside if other.frame not in taken]
    if apart:
        yield note(f"not used: {names(apart)} (tf does not say how they are mounted, or no message came)")
    if scans and clouds:
        yield note(f"not used: {names(clouds)}: scans are followed; see cloud_topics")


def _refused(survey: Survey, choice: Choice) -> Iterator[Finding]:
    for item in survey.topics.values():
        for reason, count in item.refused.items():
            level: Level = "error" if item.refused.total() >= item.count else "warning"
            yield Finding(level, f"{item.name}: {reason} ({counted(count, 'message')} refused)")


def _namespaces(survey: Survey, choice: Choice) -> Iterator[Finding]:
    known = survey.tf_namespaces()
    if len(known) > 1:
        listed = ", ".join(f"{name}/tf" for name in known)
        yield warning(
            f"tf comes on {listed}: frames of several robots mix here; that in {choice.namespace or '/'} is taken"
        )
    if choice.namespace:
        yield note(
            f"tf is on {choice.namespace}/tf, so the nodes run in that namespace: --namespace {choice.namespace}, in "
            f"launch files namespace:={choice.namespace.strip('/')}"
        )


def _tree(survey: Survey, choice: Choice) -> Iterator[Finding]:
    for child in sorted({edge.child for edge in survey.edges.values()}):
        parents = survey.parents(child)
        if len(parents) > 1:
            listed = " and ".join(f"'{name}'" for name in parents)
            yield error(
                f"frame '{child}' has two parents: {listed}. A frame has one: switch one of the publishers off"
                f"{_who(survey, child)}"
            )
    followed = survey.topics.get((choice.scans or choice.clouds or [""])[0])
    if followed is None or not followed.frame:
        return
    sensor = followed.frame.lstrip("/")
    if not survey.edges:
        yield warning(
            f"nobody says on tf how '{sensor}' is mounted: the sensor's frame stands for the robot's. For a robot run "
            f"`ros2 run tf2_ros static_transform_publisher --frame-id base_link --child-frame-id {sensor}`"
        )
    elif choice.base_frame not in survey.chain(sensor):
        yield error(f"tf does not connect '{sensor}' with the robot's frame '{choice.base_frame}'")
    elif choice.base_frame == sensor and survey.frames() - {sensor}:
        trees = ", ".join(sorted(survey.frames())[:8])
        latched = any(item.name.endswith("tf_static") and item.count for item in survey.of(TF)) or any(
            edge.static for edge in survey.edges.values()
        )
        why = "" if latched else ". No tf_static was seen: a recording has to have it, too"
        yield warning(
            f"'{sensor}' hangs on nothing in tf, which has {trees}: its frame stands for the robot's{why}"
        )


def _mounting(survey: Survey, choice: Choice) -> Iterator[Finding]:
    for name in choice.scans:
        sensor = survey.topics[name].frame.lstrip("/") if name in survey.topics else ""
        mounting = survey.mounting(sensor, choice.base_frame)
        if mounting is None:
            continue
        if mounting[2, 2] < 0.0 and level_pose(mounting) is not None:
            yield note(f"{name}: '{sensor}' is mounted upside down")
        elif level_pose(mounting) is None:
            angle = np.degrees(np.arccos(min(abs(mounting[2, 2]), 1.0)))
            yield warning(
                f"{name}: '{sensor}' is tilted by {angle:.0f}° on '{choice.base_frame}': scans are projected to the "
                "floor, and people are not found in them"
            )


def _who(survey: Survey, child: str) -> str:
    topics = sorted({name for edge in survey.edges.values() if edge.child == child for name in edge.topics})
    nodes = sorted(
        {node for name in topics if name in survey.topics for node in survey.topics[name].publishers}
    )
    return f" (on {' and '.join(topics)}{', by one of ' + ', '.join(nodes) if nodes else ''})"


def _publishers(survey: Survey, choice: Choice) -> Iterator[Finding]:
    for edge in survey.edges.values():
        if edge.disagreeing:
            yield error(
                f"two publishers place '{edge.child}' in '{edge.parent}' and disagree: it leaps there and back. Switch "
                f"one of them off{_who(survey, edge.child)}"
            )
    for item in survey.of(SCAN, CLOUD, ODOMETRY):
        if len(item.publishers) > 1:
            yield error(f"{item.name} has two publishers: {', '.join(item.publishers)}")


def _clocks(survey: Survey, choice: Choice) -> Iterator[Finding]:
    lags = {
        item.name: item.lag
        for item in survey.of(*USED)
        if item.lag is not None and "static" not in item.name and not item.unstamped
    }
    if len(lags) < 2:
        return
    # What was recorded of a robot has one more clock, the recorder's, which says nothing.
    middle = sorted(lags.values())[len(lags) // 2]
    for name, lag in lags.items():
        off = lag - middle
        if abs(off) > APART:
            word = "behind" if off > 0 else "ahead of"
            yield Finding(
                "error" if abs(off) > FAR_APART else "warning",
                f"{name}: its clock is {abs(off):.1f} s {word} the others: synchronise the machines with chrony or "
                "PTP, and set use_sim_time for all nodes or for none",
            )


def _qos(survey: Survey, choice: Choice) -> Iterator[Finding]:
    for item in survey.of(TF):
        latched = item.name.endswith("tf_static")
        for offer in item.qos:
            if offer.reliability == "best_effort":
                yield error(f"{item.name} is published best effort; every listener of tf asks for reliable")
            if latched and offer.durability == "volatile":
                yield error(
                    f"{item.name} is published volatile: who comes later never hears it. Publish it transient_local, "
                    "as tf2_ros's StaticTransformBroadcaster does"
                )


def _odometry(survey: Survey, choice: Choice) -> Iterator[Finding]:
    link = f"'{choice.odom_frame}' -> '{choice.base_frame}'"
    if choice.base_publishes_tf:
        yield note(f"the base publishes {link} and keeps it: scan_registration publishes messages only")
    else:
        yield note(f"scan_registration publishes {link}")
    if choice.map_published and not any(name.endswith("/loop_closure") for name in survey.suite):
        yield warning(
            f"'{choice.map_frame}' -> '{choice.odom_frame}' is published already, by a mapper or localiser: "
            "loop_closure leaves it alone. To have the map of this suite switch that off, and set loop_closure's "
            "publish_tf: true"
        )
    others = [item for item in survey.of(ODOMETRY) if item.name != choice.wheels]
    if choice.wheels:
        yield note(f"wheels: {choice.wheels}")
    elif others:
        yield warning(
            f"none of {names(others)} is taken for wheel odometry; name it in wheel_topic if one is"
        )
    else:
        yield note("no wheel odometry: long corridors and fast turns are followed less surely")


def _objects(survey: Survey, choice: Choice) -> Iterator[Finding]:
    given = choice.detector
    found = [item for item in survey.topics.values() if item.name in given.values()]
    cameras = [item for item in survey.of(*CAMERAS) if item not in found]
    if not given:
        if cameras:
            yield note(f"not used: {names(cameras)}: objects come from a detector of vision_msgs")
        return
    listed = ", ".join(str(value) for key, value in given.items() if key.endswith("_topic"))
    yield note(f"objects: {listed}")
    boxes = str(given.get("detections_2d_topic", ""))
    if boxes and "camera_info_topic" not in given:
        yield warning(
            f"{boxes}: no CameraInfo has its frame '{survey.topics[boxes].frame}': boxes are not placed without"
        )
    elif boxes and not {"depth_topic", "depth_from_scan"} & set(given):
        yield warning(f"{boxes}: no depth image has its frame: boxes are not placed without one")
    if cameras:
        yield note(f"not used: {names(cameras)}")


def _others(survey: Survey, choice: Choice) -> Iterator[Finding]:
    seen = survey.of(IMU)
    if seen:
        yield note(f"not used, as no node takes them: {names(seen)}")
    for line in survey.troubles:
        yield warning(line)
    for line in survey.left_out:
        yield note(line.removeprefix("note: "))
