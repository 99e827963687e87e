"""Which objects there are: probabilistic multiple hypothesis anchoring beside WIRE, and the experiments of chapter 2.

Scenes: 600 updates at 20 Hz, p_D 0.95, 0.2 false detections per update, class and colour distributions. Then
section 2.6.1 (dynamic objects on a table), 2.6.2 (ambiguous cups, both settings), 2.6.3 (ants, simulated: the
videos are not available), and recordings where they are present.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from evaluation.experiments.anchoring_landmarks import LandmarkWorld
from evaluation.experiments.anchoring_recorded import LandmarkRun, anchored, landmark_run, tracking_run
from evaluation.experiments.anchoring_scenes import AntRun, ants, known, play, scenes
from evaluation.experiments.anchoring_table import cups, cups_in_words, dynamic_table
from evaluation.report import Options, Report, Table
from whereabouts.progress import track
from whereabouts.simulation.ants import AntScene
from world_model import WorldModel

WIRE = {
    "10 objects": ("26", "", "1.5"),
    "20 objects": ("31", "", "3.9"),
    "30 objects": ("39", "", "8.3"),
    "100 objects, 20 in view": ("183", "943", "26"),
    "twins 15 cm apart": ("merged", "", ""),
    "one of 10 removed": ("stays", "", ""),
    "one carried": ("doubled", "", ""),
}


def run(options: Options) -> Report:
    """All tables and pictures; recordings are left out, and said so, where they are absent."""
    report = Report("anchoring")
    if options.quick:
        report.notes.append(
            "quick: one run per scene, 4 runs of ants, one robot, two sequences; the same protocol."
        )
    _scenes(options, report)
    _table(options, report)
    _cups(options, report)
    _ants(options, report)
    _simulated_landmarks(options, report)
    if options.data is None:
        report.notes.append("no recordings: landmarks and vehicles are left out")
    else:
        _landmarks(options, report, options.data / "landmarks")
        _vehicles(options, report, options.data / "objects_3d" / "kitti_tracking")
    return report


def _scenes(options: Options, report: Report) -> None:
    repetitions = 1 if options.quick else 5
    rows: list[list[Any]] = []
    made = [scenes(options.seed + k) for k in range(repetitions)]
    for name in track(list(made[0]), "scenes"):
        runs = [play(each[name]) for each in made]
        theirs = WIRE.get(name, ("", "", ""))
        exact = sum(r.objects == r.true for r in runs)
        switches = sum(r.switches for r in runs)
        mean = float(np.mean([r.mean_ms for r in runs]))
        ends = ", ".join(f"{r.objects} of {r.true}" for r in runs[:2])
        rows.append(
            [name, theirs[0], ends, f"{exact} of {len(runs)}", theirs[1], switches, theirs[2], round(mean, 2)]
        )
        report.figures[f"{name} exact_share"] = exact / len(runs)
        report.figures[f"{name} switches"] = float(switches)
        report.figures[f"{name} mean_ms"] = mean
    columns = [
        "scene",
        "WIRE: objects at the end",
        "ours, first runs",
        "exact count",
        "WIRE: switches",
        "ours, all runs",
        "WIRE: ms per update",
        "ours, processor time",
    ]
    report.tables.append(Table("Scenes, 100 hypotheses", columns, rows))
    report.pictures.append(_draw_world(options))


def _draw_world(options: Options) -> Path:
    """A world from above: symbols, most probable colours and 99 % ellipses of one scene."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Ellipse

    scene = scenes(options.seed)["20 objects"]
    model = WorldModel(known(scene))
    for seen in scene.looks(100 if options.quick else 600):
        state = model.update(seen.evidence, seen.stamp)
    figure = Figure(figsize=(6.0, 6.0), layout="constrained")
    axes = figure.add_subplot()
    for position in seen.truth.values():
        axes.plot(*position[:2], "+", color="black", markersize=8)
    shades = {"white": "lightgray"}
    for item in state.objects:
        color = item.most_probable("color")
        values, vectors = np.linalg.eigh(item.covariance[:2, :2])
        width, height = 2.0 * np.sqrt(9.21 * values)
        turn = float(np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0])))
        x, y = item.position[:2].tolist()
        axes.plot(x, y, "o", color=shades.get(color, color), markersize=7, alpha=0.6)
        axes.add_patch(Ellipse((x, y), width, height, angle=turn, fill=False))
        axes.annotate(item.id, (x, y), xytext=(6, 4), textcoords="offset points", fontsize=9)
    axes.set(xlabel="x, m", ylabel="y, m", aspect="equal")
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / "world-symbols.png"
    figure.savefig(path, dpi=100)
    return path


def _table(options: Options, report: Report) -> None:
    rows = [list(row) for row in dynamic_table(options.seed)]
    report.tables.append(
        Table("Section 2.6.1: dynamic objects on a table", ["situation", "text", "ours"], rows)
    )


def _cups(options: Options, report: Report) -> None:
    said = {
        True: ("a new cup", "a new cup, as before"),
        False: ("the cup was moved", "corrected: the cup never moved, the other is new"),
    }
    rows = []
    for often_new, (part, after) in said.items():
        states = cups(often_new, options.seed)
        setting = "new cups likely, constant position" if often_new else "new cups unlikely, cups are moved"
        rows.append([setting, part, cups_in_words(states[235]), after, cups_in_words(states[-1])])
        report.figures[f"cups {'new' if often_new else 'moved'} count"] = float(len(states[-1].objects))
    columns = ["setting", "text, partly hidden", "ours", "text, all in view", "ours"]
    report.tables.append(Table("Section 2.6.2: ambiguities with cups", columns, rows))


VIDEO = 113
"""Images of a video on average: the sixteen of section 2.6.3 contain over 1,800."""


def _ants(options: Options, report: Report) -> None:
    count, looks = (4, 300) if options.quick else (16, 600)
    scenes_ = [AntScene(seed=options.seed + k) for k in range(count)]
    short = [ants(scene, VIDEO) for scene in track(scenes_, "ants, as long as the videos")]
    runs = [ants(scene, looks) for scene in track(scenes_, "ants")]
    clean = [sum(r.mixed == 0 for r in each) for each in (short, runs)]
    mean = [float(np.mean([r.mean_ms for r in each])) for each in (short, runs)]
    rows: list[list[Any]] = [
        ["runs without a mixed identity", "12 of 16", *(f"{c} of {count}" for c in clean)],
        [
            "ants with another identity at the end, of all",
            "",
            *(f"{sum(r.mixed for r in each)} of {20 * count}" for each in (short, runs)),
        ],
        [
            "merged detections per run",
            "",
            *(round(float(np.mean([r.merged for r in each])), 1) for each in (short, runs)),
        ],
        ["changes taken back", "in 2 runs", *(sum(r.corrected for r in each) for each in (short, runs))],
        ["ms per image", 29, *(round(m, 2) for m in mean)],
    ]
    columns = ["", "text (videos)", f"ours, {VIDEO} images each", f"ours, {looks} images each"]
    report.tables.append(Table("Section 2.6.3: ants, simulated", columns, rows))
    report.figures["ants clean_runs as long as the videos"] = float(clean[0])
    report.figures["ants clean_runs"] = float(clean[1])
    report.figures["ants mean_ms"] = mean[1]
    report.pictures.append(_draw_counts(options.out, runs[0]))


def _draw_counts(folder: Path, run: AntRun) -> Path:
    """Figure 2.11: expected number of ants, and detections, over time."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 3.0), layout="constrained")
    axes = figure.add_subplot()
    axes.plot(run.counts[:, 1], ".", color="tab:red", markersize=3, label="detections")
    axes.plot(run.counts[:, 0], color="black", label="expected number of ants")
    axes.set(xlabel="image", ylabel="ants", ylim=(0, None))
    axes.legend(loc="lower right")
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "figure-2-11-ants.png"
    figure.savefig(path, dpi=120)
    return path


HELD_OUT = 20
"""Seed of the first simulated world of landmarks that no setting was chosen on."""


def _simulated_landmarks(options: Options, report: Report) -> None:
    """Worlds with and without errors of the camera, each with learning and without."""
    rows: list[list[Any]] = []
    minutes = 3.0 if options.quick else 15.0
    for errors in (True, False):
        found: dict[bool, list[LandmarkRun]] = {True: [], False: []}
        for k in range(1 if options.quick else 3):
            world = LandmarkWorld(options.seed + HELD_OUT + k, minutes, errors)
            for learn, runs in found.items():
                runs.append(anchored(world.sightings(), learn=learn))
        shares = [
            [round(100 * r.right, 1) for r in found[False]],
            [round(100 * r.right, 1) for r in found[True]],
            [round(100 * r.corrected, 1) for r in found[True]],
        ]
        kind = "with errors" if errors else "without"
        rows.append([kind, *(", ".join(map(str, share)) for share in shares)])
        report.figures[f"simulated landmarks {kind} right_percent"] = float(np.mean(shares[1]))
        report.figures[f"simulated landmarks {kind} corrected_percent"] = float(np.mean(shares[2]))
    columns = [
        "camera",
        "with the right landmark at once, nothing learned, %",
        "at once, %",
        "looking back, %",
    ]
    report.tables.append(Table("Landmarks, simulated", columns, rows, f"{minutes:.0f} minutes each"))


def _landmarks(options: Options, report: Report, folder: Path) -> None:
    rows = []
    for recording in sorted(folder.glob("mrclam*")) if folder.exists() else []:
        for robot in (1,) if options.quick else range(1, 6):
            found = landmark_run(recording, robot)
            rows.append(
                [
                    recording.name,
                    robot,
                    found.detections,
                    found.landmarks,
                    round(100 * found.right, 1),
                    round(100 * found.corrected, 1),
                ]
            )
            report.figures[f"{recording.name} robot {robot} corrected_percent"] = 100 * found.corrected
            report.figures[f"{recording.name} robot {robot} right_percent"] = 100 * found.right
    if not rows:
        report.notes.append("landmarks/mrclam6 is absent")
        return
    columns = [
        "recording",
        "robot",
        "detections of landmarks",
        "landmarks",
        "with the right one, at once, %",
        "looking back at the end, %",
    ]
    report.tables.append(
        Table("Landmarks without barcodes", columns, rows, "true poses; σ 0.05 m and 0.015 rad; bias learned")
    )


def _vehicles(options: Options, report: Report, folder: Path) -> None:
    sequences = [path.name.split("_")[1].split(".")[0] for path in sorted(folder.glob("label_*"))]
    rows = []
    totals = np.zeros(2)
    for sequence in sequences[:2] if options.quick else sequences:
        ours, theirs = tracking_run(folder, sequence, options.seed)
        totals += [ours.switches, theirs.switches]
        rows.append(
            [
                sequence,
                theirs.switches,
                ours.switches,
                round(theirs.idf1, 3),
                round(ours.idf1, 3),
                ours.true_count,
            ]
        )
        report.figures[f"kitti {sequence} idf1"] = ours.idf1
    if not rows:
        report.notes.append("objects_3d/kitti_tracking is absent")
        return
    report.figures["kitti switches"], report.figures["kitti switches gnn"] = map(float, totals)
    columns = ["sequence", "switches, GNN", "ours", "IDF1, GNN", "ours", "labels"]
    report.tables.append(
        Table("KITTI tracking, simulated detections", columns, rows, "σ 0.2 m, p_D 0.9, 0.3 false per frame")
    )
