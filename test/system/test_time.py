"""What stamps that are late, early or wrong do to running nodes: no reset; and one where time itself goes back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from harness import START, Graph, Robot, scan_message
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from test_loop_closure import Mapper
from test_target_tracker import LIDAR, TrackedScene
from test_world_model import ON_COUNTER, ON_DESK, ON_TABLE, World, evidence, seen, stamp
from tf2_msgs.msg import TFMessage

from estimation.geometry.poses import between
from whereabouts.nodes.messages.stamps import NANOSECONDS, time_message
from whereabouts.nodes.messages.transforms import transform_message
from whereabouts.simulation import joined
from whereabouts.simulation.movers import outlines as people
from whereabouts_msgs.msg import TargetArray, WorldState
from world_model.warm_up import warm_up

YEAR = 365.0 * 24 * 3600


@pytest.fixture(scope="module", autouse=True)
def _compiled() -> None:
    """Nodes are waited for as if everything was compiled already."""
    warm_up()


def nobody(seconds: float) -> TargetArray:
    """What the tracker says where nobody is."""
    message = TargetArray(targets=[])
    message.header.stamp, message.header.frame_id = time_message(stamp(seconds)), "map"
    return message


def names(state: WorldState) -> list[str]:
    return [item.id for item in state.objects]


def of(node: str, said: list[DiagnosticArray]) -> list[dict[str, str]]:
    """A node's figures, the latest last."""
    mine = [status for message in said for status in message.status if status.name == node]
    return [{item.key: item.value for item in status.values} for status in mine]


def settled(graph: Graph, node: str, said: list[DiagnosticArray]) -> dict[str, str]:
    """A node's figures after all that was sent until now."""
    before = len(of(node, said))
    graph.until(lambda: len(of(node, said)) >= before + 3, "fresh diagnostics of the node's own")
    return of(node, said)[-1]


@pytest.mark.parametrize("late", [1.3, 5.0])
def test_a_detector_seconds_behind_the_people_topic_resets_nothing_and_is_believed(
    graph: Graph, late: float
) -> None:
    world = World(graph)
    cup = seen(ON_TABLE, "cup", "red")
    for k in range(80):
        world.send(nobody(100.0 + 0.1 * k), "targets")
        world.send(evidence(100.0 - late + 0.1 * k, *([cup] if k < 20 else [])))
        if k == 19:
            graph.until(lambda: names(world.states[-1]) == ["cup-1"], "the cup is believed in")
    figures = settled(graph, "world_model", world.diagnostics)
    assert figures["new runs"] == "0"
    assert figures["/evidence dropped"] == "0"
    # It also says what has gone.
    assert names(world.states[-1]) == []


@pytest.mark.parametrize("apart", [1.5, 5.0])
def test_two_cameras_with_clocks_apart_reset_nothing(graph: Graph, apart: float) -> None:
    world = World(graph)
    cup, bowl = seen(ON_TABLE, "cup", "red"), seen(ON_COUNTER, "bowl", "green")
    for k in range(30):
        world.send(evidence(100.0 + 0.1 * k, cup, view=False))
        world.send(evidence(100.0 - apart + 0.1 * k, bowl, view=False))
    figures = settled(graph, "world_model", world.diagnostics)
    assert (figures["new runs"], figures["/evidence dropped"]) == ("0", "0")
    assert names(world.states[-1]) == ["bowl-1", "cup-1"]


@pytest.mark.parametrize("off", [YEAR, 20.0, 3.0, -3.0, -20.0, -YEAR, -1e9])
def test_one_message_of_any_stamp_costs_the_world_nothing(graph: Graph, off: float) -> None:
    world = World(graph)
    cup = seen(ON_TABLE, "cup", "red")
    world.look(0.0, 15, cup)
    message = evidence(0.0, cup)
    message.header.stamp = time_message(max(stamp(1.4 + off), -(2**31) * NANOSECONDS))
    world.send(message)
    world.look(1.5, 15, cup)
    figures = settled(graph, "world_model", world.diagnostics)
    assert figures["new runs"] == "0"
    assert names(world.states[-1]) == ["cup-1"]
    wrong = abs(off) > 6.0
    assert figures["/evidence dropped"] == str(int(wrong))
    # Before 1970 there was no message.
    said = "refused: header.stamp" if stamp(1.4 + off) < 0 else "held back until other messages confirm it"
    assert (said in graph.log(world.spec)) == wrong


def test_after_a_restart_one_message_ahead_does_not_age_what_is_remembered(
    graph: Graph, tmp_path: Path
) -> None:
    world = World(graph, store_path=str(tmp_path / "world.sqlite"))
    cup = seen(ON_TABLE, "cup", "red")
    world.look(0.0, 15, cup)
    graph.kill(world.spec)
    world.states.clear()
    world.start()
    graph.until(lambda: world.states, "the remembered world")
    world.send(evidence(YEAR, cup, view=False))
    # An hour later, and the robot looks elsewhere.
    for k in range(5):
        world.send(evidence(3600.0 + 0.1 * k, view=False))
    graph.until(lambda: world.figures().get("updates") == "5", "all but the wrong one are taken")
    assert world.figures()["new runs"] == "0"
    assert names(world.states[-1]) == ["cup-1"]


def test_a_live_node_judges_alike(graph: Graph) -> None:
    world = World(graph, report_processed=False)
    cup = seen(ON_TABLE, "cup", "red")

    def look(seconds: float) -> None:
        before = len(world.states)
        graph.publish("evidence", evidence(seconds, cup))
        graph.until(lambda: len(world.states) > before, f"the look at {seconds}")

    for k in range(15):
        look(0.1 * k)
    graph.publish("evidence", evidence(YEAR, cup))
    for k in range(15, 30):
        look(0.1 * k)
    look(0.2)
    figures = settled(graph, "world_model", world.diagnostics)
    assert (figures["new runs"], figures["/evidence dropped"], figures["/evidence late"]) == ("0", "1", "1")
    # The whole again, as a bag that loops: the first look is confirmed by the second.
    graph.publish("evidence", evidence(-50.0, cup))
    look(-49.9)
    figures = settled(graph, "world_model", world.diagnostics)
    assert (figures["new runs"], figures["/evidence dropped"]) == ("1", "1")
    assert names(world.states[-1]) == ["cup-1"]


def test_a_stalled_detector_comes_back_without_a_reset(graph: Graph) -> None:
    world = World(graph)
    cup = seen(ON_TABLE, "cup", "red")
    for k in range(300):
        world.send(nobody(0.1 * k), "targets")
        if k < 30 or k >= 250:
            world.send(evidence(0.1 * k, cup))
    figures = settled(graph, "world_model", world.diagnostics)
    assert (figures["new runs"], figures["/evidence dropped"]) == ("0", "0")
    assert names(world.states[-1]) == ["cup-1"]


def test_a_looped_bag_is_one_new_run_and_the_world_is_still_known(graph: Graph) -> None:
    world = World(graph)
    cup, shoe = seen(ON_TABLE, "cup", "red"), seen(ON_DESK, "shoe", "blue")
    for loop in range(2):
        for k in range(30):
            world.send(nobody(100.0 * (1 - loop) + 0.1 * k), "targets")
            # The second time only the shoe is looked at.
            world.send(evidence(100.0 * (1 - loop) + 0.1 * k, *([cup, shoe], [shoe])[loop], view=not loop))
    figures = settled(graph, "world_model", world.diagnostics)
    assert (figures["new runs"], figures["/evidence dropped"], figures["/targets dropped"]) == ("1", "0", "0")
    assert "went back" in figures["last new run"]
    assert graph.log(world.spec).count("a new run begins") == 1
    assert names(world.states[-1]) == ["cup-1", "shoe-1"]
    assert world.states[-1].epoch == 1
    assert figures["objects not seen in this run"] == "1"


@pytest.mark.parametrize("first", ["clock", "messages"])
def test_a_jump_of_the_clock_is_one_new_run_whoever_tells_first(graph: Graph, first: str) -> None:
    world = World(graph, use_sim_time=True)
    cup = seen(ON_TABLE, "cup", "red")

    def tick(seconds: float) -> None:
        graph.publish("/clock", Clock(clock=time_message(stamp(seconds))))

    for k in range(20):
        tick(100.0 + 0.1 * k)
        world.send(evidence(100.0 + 0.1 * k, cup))
    if first == "clock":
        tick(0.0)
        graph.until(lambda: "/clock went back" in graph.log(world.spec), "the jump is told")
        # What was under way is of the time before.
        world.send(evidence(102.0, cup))
    for k in range(20):
        world.send(evidence(0.1 * k, cup))
        if first == "clock" or k > 5:
            tick(0.1 * k)
    figures = settled(graph, "world_model", world.diagnostics)
    assert figures["new runs"] == "1", graph.log(world.spec)
    assert names(world.states[-1]) == ["cup-1"]


def test_one_late_odometry_message_leaves_the_map_alone_and_a_loop_takes_it_up_again(graph: Graph) -> None:
    robot = Mapper(graph)
    graph.start("scan_registration")
    spec = graph.start("loop_closure")
    graph.mount()
    robot.introduce()
    robot.go(0.0, 30.0, 0.25)
    figures = settled(graph, "loop_closure", robot.diagnostics)
    kept, runs = int(figures["keyframes"]), figures["new runs"]
    assert kept > 10, f"{figures}\n{graph.log(spec)}"
    late = Odometry()
    late.header.stamp, late.header.frame_id = time_message(START + round(28.35 * NANOSECONDS)), "odom"
    late.child_frame_id = "base_link"
    late.pose.pose.orientation.w = 1.0
    graph.publish("odometry", late)
    moved = transform_message(
        "odom", "base_link", START + round(YEAR * NANOSECONDS), (9.0, 0, 0, 0, 0, 0, 1.0)
    )
    graph.publish("tf", TFMessage(transforms=[moved]))
    robot.go(30.0, 32.0, 0.25)
    figures = settled(graph, "loop_closure", robot.diagnostics)
    assert figures["new runs"] == runs
    assert int(figures["keyframes"]) >= kept
    # The same drive once more: the robot is found in the map it had.
    robot.transforms.clear()
    robot.go(0.0, 20.0, 0.25)
    figures = settled(graph, "loop_closure", robot.diagnostics)
    assert figures["new runs"] == str(int(runs) + 1)
    # On a busy machine the map gets to see few of the scans.
    now = 20.0
    while "found in the map of the previous run" not in graph.log(spec):
        assert now < 120.0, f"{figures}\n{graph.log(spec)}"
        robot.go(now, now + 1.0, 0.25)
        now += 1.0
        figures = settled(graph, "loop_closure", robot.diagnostics)
    assert int(figures["keyframes"]) >= kept
    pose = graph.until(robot.in_map, "tf has the robot in the map")[0]
    miss = between(robot.truth(now - 0.25), pose)
    assert np.hypot(*miss[:2]) < 0.3
    assert abs(miss[2]) < 0.1


def test_scans_that_waited_for_slow_transforms_are_mapped(graph: Graph) -> None:
    """A robot that says less often where it is than its scanner turns."""
    robot = Mapper(graph)
    spec = graph.start("loop_closure")
    graph.mount()
    times = [0.025 * k for k in range(9)]
    for time in times:
        graph.publish("scan", scan_message(robot.scan(time)))
    graph.until(lambda: len(robot.mapped) >= len(times), "all scans are there")
    for time in (times[0], times[-1]):
        x, y, yaw = robot.drive(time)
        turn = (0.0, 0.0, np.sin(0.5 * yaw), np.cos(0.5 * yaw))
        base = transform_message("odom", "base_link", START + round(time * NANOSECONDS), (x, y, 0.0, *turn))
        graph.publish("tf", TFMessage(transforms=[base]))
    figures = settled(graph, "loop_closure", robot.diagnostics)
    assert figures["/scan used"] == str(len(times)), graph.log(spec)


def test_a_scan_in_an_unknown_frame_holds_up_nobody_and_is_given_up_by_message_time(graph: Graph) -> None:
    robot = Robot(graph)
    spec = graph.start("scan_registration", transform_timeout=0.3)
    graph.mount()
    robot.go(0.0, 0.5)
    robot.send(scan_message(robot.scan(0.5), "moon"))
    robot.go(0.6, 0.75)
    graph.until(lambda: len(robot.odometry) == 7, "the scans behind it are used at once")
    assert figure(robot, "/scan dropped") == "0"
    robot.go(0.8, 1.45)
    graph.until(lambda: figure(robot, "/scan dropped, no transform") == "1", "it is given up")
    assert "no transform from 'moon' to 'base_link'" in graph.log(spec)
    assert len(robot.odometry) == 14


def figure(robot: Robot, name: str) -> Any:
    return robot.figures().get(name)


@pytest.mark.parametrize("off", [YEAR, 4.0, -4.0, -YEAR])
def test_one_scan_of_any_stamp_leaves_the_odometry_alone(graph: Graph, off: float) -> None:
    robot = Robot(graph)
    graph.start("scan_registration", segment_scans=False)
    graph.mount()
    robot.go(0.0, 1.0)
    wrong = scan_message(robot.scan(0.95))
    wrong.header.stamp = time_message(START + round((0.95 + off) * NANOSECONDS))
    robot.send(wrong)
    robot.go(1.0, 2.0)
    figures = settled(graph, "scan_registration", robot.diagnostics)
    assert figures["new runs"] == "0"
    poses = robot.poses()
    for moment in np.arange(1.0, 2.0, 0.1):
        pose = poses[min(poses, key=lambda m, moment=moment: abs(m - moment))]
        assert np.hypot(*(pose[:2] - robot.truth(float(moment))[:2])) < 0.05


@pytest.mark.parametrize("off", [YEAR, 3.0])
def test_people_keep_their_labels_through_a_scan_of_another_time(graph: Graph, off: float) -> None:
    scene = TrackedScene(graph)
    graph.start("scan_registration")
    graph.start("target_tracker")
    graph.mount()
    first = LIDAR.scan(joined([scene.world, people(scene.people, 0.0)]), scene.drive(0.0), scene.rng).scan
    graph.introduce(scan_message(first), lambda: scene.targets, "scan_registration", "target_tracker")
    scene.go(0.0, 4.0)
    before = {target.label for target in scene.targets[-1].targets}
    assert before
    wrong = scan_message(first)
    wrong.header.stamp = time_message(START + round((3.95 + off) * NANOSECONDS))
    scene.send(wrong)
    sent = len(scene.targets)
    scene.go(4.0, 5.0)
    graph.until(lambda: len(scene.targets) >= sent + 10, "one message per scan")
    assert before <= {target.label for target in scene.targets[-1].targets}
