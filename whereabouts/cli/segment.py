"""`whereabouts segment`: which beams of a recording hit something that moves, and where the sensor was meanwhile."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from whereabouts.cli.common import (
    JsonFile,
    TopicToUse,
    argument,
    option,
    reading,
    target_file,
    target_folder,
    write_figures,
)
from whereabouts.system.counting import counted

if TYPE_CHECKING:
    from registration.laser.scan import Scan

METHODS = ("trees", "as_printed")
PAIR = (-0.6, 0.6)  # seconds to the scan that the text's method compares with: the earlier, or else the later


def segment(
    source: Annotated[Path | None, argument("[IN]", "Any readable log with planar scans.")] = None,
    out: Annotated[
        Path | None,
        option("--out", "labels.npz, or with --train the model's JSON file.", callback=target_file),
    ] = None,
    topic: TopicToUse = None,
    model_file: Annotated[
        Path | None, option("--model", "Use this trained model instead of the shipped one.")
    ] = None,
    method: Annotated[
        str,
        option(
            "--method",
            "trees: over a window of scans; as_printed: the joint CRF of the text, from pairs of scans.",
        ),
    ] = "trees",
    pictures: Annotated[
        Path | None,
        option("--pictures", "Folder for pictures of some labelled scans.", callback=target_folder),
    ] = None,
    train: Annotated[
        bool, option("--train", "Train a model on simulated labelled pairs and write it to --out.")
    ] = False,
    json_file: JsonFile = None,
) -> None:
    """Label every beam of a recording: moving or static.

    The file holds three arrays. `labels` (N, beams): number of the moving segment from 1 on; 0 static; -1 no return or
    unknown. `stamps` (N,): seconds. `poses` (N, 3): of the sensor in the frame of the first scan, metres and radians.
    Short scans are filled up with -1.
    """
    from estimation.errors import InputError

    if method not in METHODS:
        raise InputError(f"--method: one of {', '.join(METHODS)} expected, got {method!r}")
    if train:
        if out is None:
            raise InputError("--out: where to write the trained model")
        _train(out, method, json_file)
        return
    if source is None:
        raise InputError("IN: a log to label, or --train")
    _label(source, out, topic, (method, model_file), pictures, json_file)


def _train(out: Path, method: str, json_file: Path | None) -> None:
    from evaluation.crf.crf_training import train_printed, train_shipped

    started = time.perf_counter()
    model = train_shipped() if method == "trees" else train_printed()
    model.save(out)
    typer.echo(
        f"trained on {model.card['pairs']} pairs in {time.perf_counter() - started:.0f} s, written to {out}"
    )
    write_figures(json_file, {"pairs": model.card["pairs"]})


def _label(
    source: Path, out: Path | None, topic: str | None, how: tuple[str, Path | None], pictures: Path | None,
    json_file: Path | None,
) -> None:  # fmt: skip
    import numpy as np

    from whereabouts.system.progress import track

    segment_scan = _segmenter(*how)
    scans, landed, stamps, poses = _read(source, topic)
    started = time.perf_counter()
    labels = np.full((len(scans), max(len(scan) for scan in scans)), -1, dtype=np.int64)
    for index in track(range(len(scans)), f"labelling {source.name}"):
        found = segment_scan(scans, stamps, poses, index)
        labels[index, : len(found)] = np.where(landed[index] >= 0, found[landed[index]], -1)
    elapsed = time.perf_counter() - started
    returned, moving = int((labels >= 0).sum()), int((labels > 0).sum())
    if out is not None:
        _write(out, labels, stamps, poses)
    if pictures is not None:
        draw(pictures, scans, labels, stamps)
    typer.echo(
        f"{counted(len(scans), 'scan')}, {moving} of {returned} labelled beams move, "
        f"{len(scans) / max(elapsed, 1e-9):.0f} scans/s{f', written to {out}' if out else ''}"
    )
    figures: dict[str, Any] = {"source": str(source), "scans": len(scans), "moving_beams": moving}
    figures |= {"labelled_beams": returned, "scans_per_second": len(scans) / max(elapsed, 1e-9)}
    write_figures(json_file, figures)


def _segmenter(method: str, model_file: Path | None) -> Callable[[list[Scan], Any, Any, int], Any]:
    """What labels a scan of a recording, by the scans, their stamps and poses, and its number."""
    from registration.crf import JointModel
    from registration.crf.as_printed import PrintedCrf
    from registration.crf.window import partners
    from registration.crf.window import segment as over_window

    if method == "trees":
        model = JointModel.load(model_file)
        return lambda scans, stamps, poses, index: over_window(model, scans, stamps, poses, index)
    printed = PrintedCrf.load(model_file)

    def of_pair(scans: list[Scan], stamps: Any, poses: Any, index: int) -> Any:
        import numpy as np

        others = partners(stamps, poses, index, PAIR)
        if not others:
            return np.full(len(scans[index]), -1, dtype=np.int64)
        return printed.infer(scans[index], scans[others[0]]).clusters

    return of_pair


def _read(source: Path, topic: str | None) -> tuple[list[Scan], list[Any], Any, Any]:
    """Scans of a log as seen from their first beams, which beam of these each beam is (-1: none, no return), their
    stamps (N,) and sensor poses (N, 3) by odometry."""
    import numpy as np

    from registration.laser.sweep import moved_to_first_beam
    from registration.odometry.follower import Odometry

    odometry = Odometry()
    with reading(source, "following", topic=topic) as log:
        scans: list[Scan] = []
        landed: list[Any] = []
        poses: list[Any] = []
        for record in log.records.scans(topic):
            poses.append(odometry.register(record.scan, record.stamp))
            elapsed = record.stamp - scans[-1].stamp if scans else 0.0
            seen, beams = moved_to_first_beam(record.scan, odometry.increment, elapsed)
            scans.append(seen)
            landed.append(np.where(record.scan.valid, beams, -1))
            log.advance(len(scans))
        log.require(len(scans), "scans")
    return scans, landed, np.array([scan.stamp for scan in scans]), np.array(poses)


def _write(out: Path, labels: Any, stamps: Any, poses: Any) -> None:
    import numpy as np

    from whereabouts.system.atomic import atomic_path

    with atomic_path(out) as temporary, temporary.open("wb") as stream:
        np.savez_compressed(stream, labels=labels, stamps=stamps, poses=poses)


def draw(folder: Path, scans: list[Scan], labels: Any, stamps: Any, count: int = 6) -> list[Path]:
    """Pictures of `count` scans spread over the recording, what moves in colour."""
    import numpy as np
    from matplotlib.figure import Figure

    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for index in np.unique(np.linspace(0, len(scans) - 1, count).astype(int)):
        scan = scans[index]
        points, found = scan.points(), labels[index, : len(scan)][scan.valid]
        figure = Figure(figsize=(6, 6))
        axes = figure.subplots()
        axes.plot(points[found <= 0, 0], points[found <= 0, 1], ".", color="0.5", markersize=3)
        moving = found > 0
        axes.scatter(points[moving, 0], points[moving, 1], c=found[moving], cmap="tab10", s=10)
        axes.plot(0, 0, "k+")
        axes.set_aspect("equal")
        axes.set_title(f"{stamps[index] - stamps[0]:.1f} s")
        path = folder / f"scan_{index:05d}.png"
        figure.savefig(path, dpi=80)
        written.append(path)
    return written
