"""The demo's report put together: figures against ground truth, pictures, and the page that tells them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.geometry.places import Places
from evaluation.demo import pictures
from evaluation.demo.belief_judging import SAME
from evaluation.demo.files import files_of
from evaluation.demo.judging import (
    Identities,
    Trajectories,
    judge_things,
    judge_tracks,
    judge_trajectories,
    rmse,
)
from evaluation.demo.page import Page, Row
from evaluation.demo.reading import Said, Truth, read_said, read_truth
from evaluation.demo.report_screen import screen_of, told_task
from evaluation.demo.screen import Screen
from evaluation.people.people_judging import SceneJudgement
from evaluation.process_usage import Usage
from whereabouts.simulation.home.apartment_day import MOVED
from whereabouts.simulation.home.floor_plan import apartment, places_file

Array = NDArray[np.float64]
# What each node is judged by: the input that makes it work.
WORK = {
    "scan_registration": "/scan",
    "loop_closure": "/scan",
    "target_tracker": "/scan",
    "motion_predictor": "/targets",
    "world_model": "/evidence",
    "world_maintenance": "/world_state",
    "verifier": "/scan",
    "object_search": "/world_state",
}
WANTED = {"trajectory": 0.15, "ospa": 0.3, "speed": 4.0, "processor": 0.45, "memory": 1.2e9 / 2**20}


@dataclass
class DemoRun:
    """What the replay came to.

    account : whereabouts.nodes.runtime.replayer.ReplayAccount. told :
    evaluation.demo.live.demo_director.Account, None where nothing was asked. usage : by full name of the node.
    """

    account: Any
    told: Any = None
    usage: Mapping[str, Usage] = field(default_factory=dict)


@dataclass
class Judged:
    """Everything the page tells."""

    truth: Truth
    said: Said
    tracks: Trajectories
    people: SceneJudgement
    people_stamps: Array
    things: Identities
    run: DemoRun
    bag: Path = Path()

    @property
    def begin(self) -> float:
        """Seconds of the bag's first scan."""
        return min(self.truth.poses, default=0.0)


def judge(recording: Path, bag: Path, run: DemoRun) -> Judged:
    """Read a run and hold it against the ground truth of its bag."""
    truth, said = read_truth(bag), read_said(recording)
    people, stamps = judge_tracks(truth, said)
    return Judged(
        truth,
        said,
        judge_trajectories(truth, said),
        people,
        stamps,
        judge_things(truth, said.worlds),
        run,
        bag,
    )


def figures(judged: Judged) -> dict[str, Any]:
    """All figures by name, for --json."""
    run, things, people = judged.run, judged.things, judged.people
    account, told = run.account, run.told
    found: dict[str, Any] = {
        "bag_s": account.bag_seconds,
        "wall_s": account.wall_seconds,
        "speed": account.bag_seconds / max(account.wall_seconds, 1e-9),
        "messages": account.published.total(),
        "lost": account.total_lost,
        "unanswered": account.unanswered.total(),
        "nodes_heard": sum(account.processed[name] > 0 for name in run.usage),
        "closures": len(judged.said.replayed.closures),
        "ospa_m": _mean(people.ospa),
        "people_missed_per_scan": _mean(people.missed),
        "people_false_per_scan": _mean(people.false),
        "people_error_m": _mean(people.errors),
        "people_switches": people.switches if people.labels else 0,
        "people": len(people.labels[0]) if people.labels else 0,
        "people_labels": len({int(label) for scan in people.labels for label in scan if label >= 0}),
        "things": things.present,
        "things_right": things.right,
        "things_missing": things.missing,
        "things_extra": things.extra,
        "things_lost": things.lost,
        "things_kept_name": things.kept,
        "identity_switches": things.switches,
        "thing_error_m": _mean(things.errors),
        "processor_s_per_bag_s": sum(u.seconds for u in run.usage.values()) / max(account.bag_seconds, 1e-9),
        "memory_proportional_mib": sum(u.proportional for u in run.usage.values()),
    }
    for name, errors in judged.tracks.errors.items():
        key = name.replace(",", "").replace(" ", "_")
        found[f"{key}_rmse_m"], found[f"{key}_max_m"] = rmse(errors), float(errors.max(initial=0.0))
    if told is not None:
        found |= {"searched": told.search, "found": told.found, "search": told.outcome}
    return found


def write(folder: Path, judged: Judged) -> Path:
    """Pictures and index.html in `folder`; returns the page's path."""
    home, found = apartment(), figures(judged)
    said, truth = judged.said, judged.truth
    page = Page(
        "A robot's morning in an apartment",
        f"{found['bag_s'] / 60.0:.1f} minutes of a simulated bag, replayed over DDS through {len(judged.run.usage)} "
        f"nodes in {found['wall_s']:.0f} s, {found['speed']:.1f} times as fast as it was.",
    )
    page.screen = _screen(judged)
    page.text(sentence_of(found))
    page.heading("Files of this run")
    page.files(files_of(folder, judged.bag, folder / "recording.mcap"))
    page.heading("For engineers: what was wanted, and what came of it")
    page.summary(summary(found, judged))
    _where(page, folder, judged, home)
    page.heading("Who is there, and where are they going?")
    page.text(
        "Each colour is a label of target_tracker, the wide green line is where people truly went. Expected are all "
        "who were in plain view for 1.5 s, until they have been hidden for 3 s."
    )
    pictures.draw_people(
        folder / "people.png", home, said, truth, (judged.people_stamps, np.array(judged.people.ospa))
    )
    page.picture("people.png", "People tracked from a driving robot, and the error of the whole set (OSPA).")
    pictures.draw_predictions(folder / "predictions.png", home, said, truth, _lively(judged))
    page.picture(
        "predictions.png", "Predicted paths of motion_predictor, likely goals, and where people then went."
    )
    _things(page, folder, judged, home)
    _missing(page, folder, judged, home)
    _costs(page, judged)
    return page.write(folder / "index.html")


def _screen(judged: Judged) -> Screen:
    """The first screen, with what was asked while the bag played."""
    screen = screen_of(judged.said, judged.truth, Places.load(str(places_file())))
    told = judged.run.told
    if told is None:
        return screen
    if told.verified_at is not None:
        screen.events.append((told.verified_at, f"somebody asks for the {MOVED}: is it still there?", ""))
    if told.started is not None:
        screen.events.append((told.started, f"it is searched for: the {MOVED}", ""))
        screen.events += [(step.stamp, step.reason, step.object) for step in told.steps]
    if told.ended is not None and told.outcome:
        screen.events.append((told.ended, told.outcome, told.object_id))
        screen.chosen = told.object_id
    screen.events.sort(key=lambda event: event[0])
    return screen


def sentence_of(found: Mapping[str, Any]) -> str:
    """What it came to, in plain words."""
    false = found["people_false_per_scan"]
    return (
        f"At the end the robot knew {found['things_right']} of {found['things']} things at their right places and "
        f"believed in {len(found['things_extra'])} that are nowhere. It gave {found['people_labels']} labels to "
        f"{found['people']} people; {100 * false:.1f} false people in 100 scans."
    )


def summary(found: Mapping[str, Any], judged: Judged) -> list[Row]:
    """What was wanted, and what came of it."""
    closed = found.get("loops_closed_rmse_m", float("nan"))
    right = found["things_right"] == found["things"] and not found["things_extra"]
    rows = [
        Row("replay speed", f"{found['speed']:.1f} × real time", "≥ 4 ×", found["speed"] >= WANTED["speed"]),
        Row(
            "trajectory error with loops closed",
            f"{closed:.3f} m (RMS), {found.get('loops_closed_max_m', float('nan')):.3f} m at most",
            "≤ 0.15 m",
            closed <= WANTED["trajectory"],
        ),
        Row(
            "people: OSPA, 1 m at most",
            f"{found['ospa_m']:.2f} m",
            "≤ 0.30 m",
            found["ospa_m"] <= WANTED["ospa"],
        ),
        Row(
            "labels for these people; missed and false per scan",
            f"{found['people_labels']} for {found['people']}; {found['people_missed_per_scan']:.2f} and "
            f"{found['people_false_per_scan']:.2f}",
            "one each",
            found["people_labels"] <= found["people"],
        ),
        Row(
            f"things at the end: right class, within {SAME:g} m",
            f"{found['things_right']} of {found['things']}, {len(found['things_extra'])} too many",
            "all, none",
            right,
        ),
        Row(
            "things that end under their first name",
            f"{found['things_kept_name']} of {found['things']}, {found['identity_switches']} changes on the way",
            "all",
            found["things_kept_name"] == found["things"],
        ),
    ]
    if judged.run.told is not None:
        rows.append(
            Row("the moved thing", found["search"] or "not looked for", "found", bool(found["found"]))
        )
    return rows + _running(found)


def _running(found: Mapping[str, Any]) -> list[Row]:
    """What of the summary is about messages, processors and memory."""
    return [
        Row(
            "messages lost, unanswered",
            f"{found['lost']}, {found['unanswered']} of {found['messages']}",
            "none",
            found["lost"] == 0 and found["unanswered"] == 0,
        ),
        Row(
            "processor seconds per second of the bag, all nodes",
            f"{found['processor_s_per_bag_s']:.2f}",
            "≤ 0.45",
            found["processor_s_per_bag_s"] <= WANTED["processor"],
        ),
        Row(
            "memory of all nodes, shared pages once",
            f"{found['memory_proportional_mib']:.0f} MiB",
            "≤ 1144 MiB (1.2 GB)",
            found["memory_proportional_mib"] <= WANTED["memory"],
        ),
    ]


def _where(page: Page, folder: Path, judged: Judged, home: Any) -> None:
    page.heading("Where am I, and have I been here before?")
    said = judged.said
    pictures.draw_map(folder / "map.png", home, said, judged.tracks)
    page.picture("map.png", "The map of loop_closure after the run.")
    pictures.draw_trajectories(folder / "trajectory.png", home, judged.tracks)
    closures = len(said.replayed.closures)
    page.picture(
        "trajectory.png",
        f"The wheels drift away, scan_registration hardly does, and {closures} closed loops take out what is left.",
    )
    rows = [
        (name, f"{rmse(errors):.3f}", f"{float(errors.max(initial=0.0)):.3f}")
        for name, errors in judged.tracks.errors.items()
    ]
    page.table(("metres from the truth", "RMS", "most"), rows, numbers=True)


def _lively(judged: Judged) -> list[float]:
    """Three moments at which most people who walk have a predicted path, at least half a minute from each other."""
    walking: list[tuple[float, float]] = []
    for stamp, paths in judged.said.paths.items():
        before = [when for when in judged.said.people if when <= stamp]
        people = {one.label: one for one in judged.said.people[max(before)]} if before else {}
        speeds = [
            float(np.linalg.norm(people[path.label].velocity))
            for path in paths
            if path.label in people and not people[path.label].hidden
        ]
        walking.append((sum(min(speed, 1.0) for speed in speeds), stamp))
    chosen: list[float] = []
    for _, stamp in sorted(walking, key=lambda item: (-item[0], item[1])):
        if all(abs(stamp - other) >= 30.0 for other in chosen):
            chosen.append(stamp)
        if len(chosen) == 3:
            break
    return sorted(chosen)


def _things(page: Page, folder: Path, judged: Judged, home: Any) -> None:
    page.heading("Which things exist, and where are they now?")
    truth, begin, found = judged.truth, judged.begin, judged.things
    end = max(truth.things, default=begin)
    moments = [begin + share * (end - begin) for share in (0.1, 0.35, 0.6, 1.0)]
    pictures.draw_worlds(folder / "world.png", home, judged.said, truth, moments)
    page.picture("world.png", "The world with its symbols; green crosses are where things truly lie.")
    rows = []
    for name, ids in sorted(found.ids.items()):
        told = ", then ".join(f"{own} ({stamp - begin:.0f} s)" for stamp, own in ids) or "never known"
        rows.append((name, told, "missing at the end" if name in found.missing else "right"))
    page.table(("thing", "known as, since", "at the end"), rows)
    if found.extra:
        page.text(f"Believed in at the end, and nothing: {', '.join(found.extra)}.")
    page.text(
        "The world model has its shipped rates: nobody told it how good its camera is or how often things come and go."
    )


def _missing(page: Page, folder: Path, judged: Judged, home: Any) -> None:
    told, begin = judged.run.told, judged.begin
    if told is None or told.verified_at is None:
        return
    page.heading("Is it still there? Where else?")
    page.text(
        f"While the robot was elsewhere, the {MOVED} was carried to another room. After "
        f"{told.verified_at - begin:.0f} s somebody asks for it: “{told.verification}”."
    )
    tasks: list[tuple[str, ...]] = []
    for task in judged.said.tasks:
        said = told_task(replace(task, outcome=""), judged.said)
        outcome = (
            f"{task.outcome} after {task.ended - task.stamp:.1f} s"
            if task.outcome
            else "no result in the world"
        )
        tasks.append((f"{task.stamp - begin:.0f} s", said, outcome, task.reason))
    page.table(("when", "why it is looked at", "outcome", "in numbers"), tasks)
    if told.started is None:
        return
    ended = told.ended if told.ended is not None else max(judged.truth.poses, default=begin)
    moved = [
        (stamp, things[MOVED]) for stamp, things in sorted(judged.truth.things.items()) if MOVED in things
    ]
    before = [spot for stamp, spot in moved if stamp <= told.started]
    pictures.draw_search(
        folder / "search.png",
        home,
        judged.truth,
        {
            "steps": [(number, step.goal) for number, step in enumerate(told.steps, start=1)],
            "start": told.started,
            "end": ended,
            "old": None if not moved else moved[0][1][:2],
            "new": None if not before else before[-1][:2],
            "found": told.place,
        },
    )
    page.text(
        f"Then it is searched for, from {told.started - begin:.0f} s on. The robot drives where it drove when this was "
        "recorded, whatever the search says; it passes the new place in the end, and the world model knows its thing "
        f"again. Result after {ended - told.started:.0f} s: {told.outcome or 'none before the bag ended'}"
        f"{f' ({told.object_id})' if told.object_id else ''}."
    )
    page.picture("search.png", "The search: its goals in order, and where the recorded drive went meanwhile.")
    rows = [
        (str(number), f"{step.stamp - begin:.0f} s", step.kind, step.reason)
        for number, step in enumerate(told.steps, start=1)
    ]
    page.table(("", "when", "goal", "reason"), rows)


def _costs(page: Page, judged: Judged) -> None:
    page.heading("What it costs")
    bag, diagnostics = judged.run.account.bag_seconds, judged.said.replayed.figures
    rows = []
    for full, usage in judged.run.usage.items():
        name = full.strip("/")
        values = diagnostics.get(name, {})
        topic = WORK.get(name, "")
        received = int(values.get(f"{topic} received", 0))
        rows.append(
            (
                name,
                f"{topic} {received / max(bag, 1e-9):.1f} Hz",
                values.get(f"{topic} latency p50 [ms]", "-"),
                values.get(f"{topic} latency p99 [ms]", "-"),
                f"{usage.resident:.0f}",
                f"{usage.proportional:.0f}",
                f"{usage.seconds:.1f}",
                f"{usage.seconds / max(bag, 1e-9):.3f}",
            )
        )
    every = judged.run.usage.values()
    rows.append(
        ("all", "", "", "", "", f"{sum(u.proportional for u in every):.0f}", f"{sum(u.seconds for u in every):.1f}",
         f"{sum(u.seconds for u in every) / max(bag, 1e-9):.3f}")
    )  # fmt: skip
    head = (
        "node",
        "input, per second of the bag",
        "p50 ms",
        "p99 ms",
        "MiB",
        "shared once",
        "processor s",
        "per bag s",
    )
    page.table(head, rows, numbers=True)
    page.text(
        "Latency: from the arrival of a message to the end of what the node does with it. Memory: resident at most, "
        "and with pages that nodes share counted by share."
    )


def _mean(values: Any) -> float:
    return float(np.mean(values)) if len(values) else float("nan")
