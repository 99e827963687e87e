"""A demo on a real recording: the map and the people in it, over DDS."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader

from estimation.errors import InputError
from estimation.geometry.places import Places
from evaluation.datasets import data_directory, recording
from evaluation.demo.demo_suite import RECORDED
from evaluation.demo.files import files_of
from evaluation.demo.page import Page
from evaluation.demo.reading import Said, Truth, read_said
from evaluation.demo.report_screen import screen_of
from evaluation.killian import recorded_bag
from whereabouts.logs import convert_log
from whereabouts.nodes.runtime.suite_run import SuiteRun, replay_spec, run_suite
from whereabouts.nodes.runtime.supervisor import SuiteError

SHARED = {
    "outdoor": "people/person_following_outdoor_1.bag.zip",
    "indoor": "people/demo_stationary_simple_environment.bag",
}
"""Recordings with people by name, below the data directory; `killian` is fetched from PyPI."""
TOPICS = ("odometry", "loop_closures", "trajectory", "map", "tf", "targets", "predicted_paths", "diagnostics")
PARAMETERS: dict[str, dict[str, Any]] = {
    "loop_closure": {"resolution": 0.1, "tf_period": 1.0, "transform_tolerance": 0.5},
    "motion_predictor": {"rate": 2.0},
}
MAPS = 60
"""Maps that are drawn of a recording, about."""
ROUGH = 0.1
"""Share of unsure scans from which on the way is not told as a fact."""
LASTING = 2.0
"""s: a label that was followed for as long is told of."""


def bag_of(name: str, folder: Path) -> Path:
    """The bag that a name or a path stands for; archives and other logs are unpacked in `folder`.

    Raises InputError where there is none.
    """
    path = Path(name)
    if name == "killian":
        path = recorded_bag(print)
    elif name in SHARED:
        known = recording(SHARED[name])
        if known is None:
            raise InputError(
                f"--bag {name}: the recording {SHARED[name]} is not on this machine (data directory: "
                f"{data_directory() or 'none; set WHEREABOUTS_DATA'}); give a bag of your own"
            )
        path = known
    if not path.exists():
        raise InputError(
            f"--bag: there is no file {path}, and no recording of that name: killian, {', '.join(SHARED)}"
        )
    folder.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".zip":
        with zipfile.ZipFile(path) as archive:
            inside = [each for each in archive.namelist() if each.endswith((".bag", ".mcap", ".db3"))]
            if len(inside) != 1:
                raise InputError(f"--bag: {path} must hold one bag, not {len(inside)}")
            unpacked = folder / Path(inside[0]).name
            unpacked.write_bytes(archive.read(inside[0]))
            path = unpacked
    if path.suffix in (".mcap", ".db3", ".bag") or path.is_dir():
        return path
    target = folder / f"{path.name.split('.')[0]}.mcap"
    convert_log(path, target)
    return target


def run_recorded(
    bag: Path,
    folder: Path,
    given: Mapping[str, Mapping[str, Any]],
    rate: float | None,
    on_event: Callable[[str], None],
    on_progress: Callable[[float], None],
) -> tuple[Said, Any]:
    """The bag through nodes in lock-step, or at a rate; what they said, and an account.

    given : parameters by node of those that take part.
    """
    output = folder / "recording.mcap"
    period = {"loop_closure": {"map_period": max(5.0, _length(bag) / MAPS)}}
    specs = [
        replay_spec(name, **{**PARAMETERS.get(name, {}), **period.get(name, {}), **own})
        for name, own in given.items()
    ]
    account = run_suite(
        SuiteRun(
            bag,
            specs,
            folder / "logs",
            record=[each for each in RECORDED if each[0] in TOPICS],
            output=output,
            rate=rate,
            on_event=on_event,
            on_progress=on_progress,
        )
    )
    said = read_said(output)
    if not len(said.replayed.poses):
        raise SuiteError(f"scan_registration published no odometry; its log says why: {folder / 'logs'}")
    return said, account


def _length(bag: Path) -> float:
    """Seconds of an MCAP file; 0 where its end does not tell, or for another."""
    if bag.suffix != ".mcap":
        return 0.0
    with bag.open("rb") as file:
        summary = make_reader(file).get_summary()
    told = None if summary is None else summary.statistics
    return 0.0 if told is None else 1e-9 * (told.message_end_time - told.message_start_time)


def figures(said: Said, account: Any) -> dict[str, Any]:
    """All figures by name, for --json."""
    lasting = _followed(said)
    return {
        "bag_s": account.bag_seconds,
        "wall_s": account.wall_seconds,
        "messages": account.published.total(),
        "scans": len(said.replayed.poses),
        "scans_per_s": len(said.replayed.poses) / max(account.wall_seconds, 1e-9),
        "path_m": said.replayed.path_length,
        "closures": len(said.replayed.closures),
        "labels": len(lasting),
        "longest_s": max(lasting.values(), default=0.0),
        "people_at_once": float(np.mean([len(people) for people in said.people.values()]))
        if said.people
        else 0.0,
        "lost": account.total_lost,
        "unanswered": account.unanswered.total(),
        "dropped": dropped(said.replayed.figures),
        "unsure": _unsure(said.replayed.figures.get("scan_registration", {})),
    }


def dropped(figures: Mapping[str, Mapping[str, str]]) -> int:
    """Messages that nodes dropped, by their last diagnostics."""
    return sum(
        int(value) for own in figures.values() for key, value in own.items() if key.endswith(" dropped")
    )


def _unsure(figures: Mapping[str, str]) -> float:
    """Share of the scans of which scan_registration said that it is unsure how the robot has moved."""
    registered = float(figures.get("registered", 0.0))
    return float(figures.get("unsure", 0.0)) / registered if registered else 0.0


def lead_of(found: Mapping[str, Any]) -> str:
    """What a run found, by its figures, in some sentences."""
    metres = f"{found['path_m']:.0f} m"
    drove = f"drove {metres}" if found["path_m"] >= 0.5 else "stood still"
    rough = found["unsure"] > ROUGH
    doubt = (
        f" In {100.0 * found['unsure']:.0f} % of the scans nothing said for certain how the robot had moved: "
        "its way, the map and the people in it are rough."
    )
    return (
        f"{found['bag_s'] / 60.0:.1f} minutes, replayed over DDS in "
        f"{found['wall_s']:.0f} s. The robot {'is believed to have driven ' + metres if rough else drove}; "
        f"{found['labels']} people were followed for {LASTING:.0f} s and longer.{doubt if rough else ''}"
    )


def _followed(said: Said) -> dict[int, float]:
    """Seconds from first to last by label, of those that lasted."""
    spans: dict[int, tuple[float, float]] = {}
    for stamp, people in sorted(said.people.items()):
        for one in people:
            spans[one.label] = (spans.get(one.label, (stamp, stamp))[0], stamp)
    return {label: last - first for label, (first, last) in spans.items() if last - first >= LASTING}


def write(folder: Path, bag: Path, said: Said, account: Any) -> Path:
    """index.html in `folder`; returns its path."""
    found, lasting = figures(said, account), _followed(said)
    screen = screen_of(said, Truth(), Places())
    screen.nothing = "This recording has no camera: only the map and people are known."
    for label, seconds in lasting.items():
        rows = screen.people.get(f"person {label}", [])
        if rows:
            screen.events.append((rows[0][0], f"person {label} is there, followed for {seconds:.0f} s", ""))
    for _, later, _ in said.replayed.closures:
        screen.events.append((later, "knows the place again: a loop is closed", ""))
    screen.events.sort(key=lambda event: event[0])
    page = Page(f"{bag.name}: a real robot among people", lead_of(found), screen)
    page.heading("Files of this run")
    page.files(files_of(folder, bag, folder / "recording.mcap"))
    page.heading("For engineers")
    names = {
        "scans": "scans with a pose", "path_m": "path, m", "closures": "closed loops",
        "labels": "labels that lasted 2 s",
        "longest_s": "longest label, s", "people_at_once": "people at a time, mean", "lost": "messages lost",
        "wall_s": "replayed in, s",
    }  # fmt: skip
    told = [(text, f"{round(found[key], 1):g}") for key, text in names.items()]
    page.table(
        ("", ""), [*told, ("scans with an unsure pose, %", f"{100.0 * found['unsure']:.1f}")], numbers=True
    )
    page.text("There is no ground truth in this recording: nobody is called false here.")
    return page.write(folder / "index.html")
