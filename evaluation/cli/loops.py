"""`whereabouts loops`: train, judge and look into what tells one place from another, on logs with poses."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from evaluation.cli.experiment import Dask
from whereabouts.cli.common import JsonFile, file_to_write, write_figures

if TYPE_CHECKING:
    from evaluation.loops.place_training import Recording
    from loop_closure.places.place_model import PlaceModel

app = typer.Typer(help="Train, evaluate and inspect the loop-closure classifier.", no_args_is_help=True)


Logs = Annotated[
    list[str],
    typer.Argument(
        metavar="LOG...",
        help="Logs with poses (any readable log), or a .csv of 3D features. LOG@PLACE names the building.",
    ),
]
Method = Annotated[str, typer.Option("--method", help="plain: the reference's AdaBoost. best: the cascade.")]
Distance = Annotated[
    float,
    typer.Option("--distance", min=0.01, help="Scans within this distance show the same place, in metres."),
]
Heading = Annotated[
    float,
    typer.Option("--heading", min=1.0, max=180.0, help="Largest difference of the headings, in degrees."),
]
PathGap = Annotated[
    float,
    typer.Option("--path-gap", min=0.0, help="Shortest path between the two scans of a pair, in metres."),
]
IndexGap = Annotated[
    int, typer.Option("--index-gap", min=1, help="Fewest places of the log between the two scans of a pair.")
]
Apart = Annotated[
    float,
    typer.Option(
        "--apart",
        min=0.0,
        help="Scans farther apart than this show different places, in metres; 0: use --distance.",
    ),
]
Neighbours = Annotated[
    bool, typer.Option("--neighbours", help="Allow positive pairs that are near along the path.")
]
LocalMapLength = Annotated[
    float,
    typer.Option(
        "--local-map", min=0.0, help="Length of path in a local map, in metres; 0 uses single scans."
    ),
]
Rounds = Annotated[
    int, typer.Option("--rounds", min=1, help="Number of decision stumps of the plain method.")
]
Negatives = Annotated[
    int, typer.Option("--negatives", min=10, help="Number of negative pairs from each log.")
]
Jobs = Annotated[int, typer.Option("--jobs", min=1, help="Number of processes.")]
Seed = Annotated[int, typer.Option("--seed", help="Random seed.")]


Out = Annotated[Path, file_to_write("--out", "model.json", "File for the model.")]
Simulation = Annotated[
    int,
    typer.Option(
        "--simulation", min=0, help="Number of simulated office floors to add to the training data."
    ),
]
Pairs = Annotated[
    int, typer.Option("--pairs", min=50, help="Number of positive pairs from each log, for the cascade.")
]
Judged = Annotated[
    bool,
    typer.Option(
        help="Also evaluate by leaving out one building at a time; the result goes into the model card."
    ),
]


@app.command()
def train(
    logs: Logs,
    out: Out,
    method: Method = "best",
    distance: Distance = 2.5,
    heading: Heading = 180.0,
    path_gap: PathGap = 20.0,
    index_gap: IndexGap = 1,
    apart: Apart = 0.0,
    local_map: LocalMapLength = 10.0,
    rounds: Rounds = 50,
    simulation: Simulation = 0,
    pairs: Pairs = 1200,
    judged: Judged = False,
    seed: Seed = 0,
    jobs: Jobs = 1,
    dask: Dask = "",
    json_file: JsonFile = None,
) -> None:
    """Train a model on logs and write it as JSON, with a card of what it was trained on.

    The cascade is trained on single scans (headings within 45°) and on local maps (up to --heading) alike.
    """
    from evaluation.loops.loops_training import train_on_logs
    from evaluation.parallel import cluster
    from loop_closure.places.pairs import PairRule
    from whereabouts.system.progress import progress_bar

    rule = PairRule(distance, path_gap, math.radians(heading), apart, index_gap)
    with cluster(dask), progress_bar() as bar:
        task = bar.add_task("training", total=None)
        model = train_on_logs(
            logs,
            rule,
            _method(method),
            local_map,
            rounds,
            simulation,
            seed,
            judged,
            pairs,
            say=lambda text: bar.update(task, description=text),
            finished=lambda trained: trained.save(out),
            jobs=jobs,
        )
    model.save(out)
    size = out.stat().st_size
    typer.echo(f"trained on {', '.join(model.card['trained_on'])}; {out}: {size / 1000:.0f} kB")
    write_figures(json_file, {"model": str(out), "bytes": size, **model.card})


ModelOption = Annotated[
    str,
    typer.Option("--model", help="Model file, or a shipped model: best or plain. Ignored with --protocol."),
]
Protocol = Annotated[
    str,
    typer.Option(
        "--protocol",
        help="model: evaluate --model. cross: train on the other buildings. k-fold: train within each log.",
    ),
]
DistancesOption = Annotated[str, typer.Option("--distances", help="Distances to evaluate at, in metres.")]
Positives = Annotated[int, typer.Option("--positives", min=10, help="Largest number of positive pairs.")]
Repetitions = Annotated[int, typer.Option("--repetitions", min=1, help="Number of permutations for k-fold.")]
Curve = Annotated[Path | None, file_to_write("--roc", "PNG", "Draw the ROC curves.")]


@app.command()
def evaluate(
    logs: Logs,
    model: ModelOption = "best",
    protocol: Protocol = "model",
    method: Method = "plain",
    distances: DistancesOption = "1,2,3",
    heading: Heading = 180.0,
    path_gap: PathGap = 20.0,
    index_gap: IndexGap = 1,
    apart: Apart = 0.0,
    neighbours: Neighbours = False,
    local_map: LocalMapLength = 10.0,
    rounds: Rounds = 50,
    positives: Positives = 3000,
    negatives: Negatives = 20_000,
    folds: Annotated[int, typer.Option("--folds", min=2, help="Number of folds for k-fold.")] = 10,
    repetitions: Repetitions = 5,
    seed: Seed = 0,
    jobs: Jobs = 1,
    dask: Dask = "",
    curve: Curve = None,
    json_file: JsonFile = None,
) -> None:
    """Judge a classifier of places: detection rate D at 0, 0.1 and 1 % false alarms.

    The two scans of a pair are more than --path-gap metres of path apart. A pair is positive if they lie within one of
    --distances. Negative pairs are drawn at random from the rest.
    """
    from dataclasses import replace

    from evaluation.loops.loops_data import Reading, read_recording
    from evaluation.loops.loops_judging import HEADING, JudgingPlan, draw_curves, judge
    from evaluation.parallel import cluster
    from loop_closure.places.pairs import PairRule
    from whereabouts.system.progress import track

    reading = Reading(local_map=local_map)
    recordings = [read_recording(log, reading) for log in track(logs, "reading")]
    rule = PairRule(1.0, path_gap, math.radians(heading), apart, index_gap, neighbours)
    rules = [replace(rule, distance=value) for value in _numbers(distances)]
    chosen = _model(model, recordings) if protocol == "model" else None
    with cluster(dask):
        plan = JudgingPlan(
            protocol, chosen, _method(method), rounds, positives, negatives, folds, repetitions, seed
        )
        found = judge(recordings, rules, plan, jobs, "judging")
    typer.echo("\n".join([HEADING, *(row.line() for row in found)]))
    if curve is not None:
        draw_curves(found, curve)
    write_figures(json_file, {"protocol": protocol, "results": [row.as_dict() for row in found]})


@app.command()
def inspect(
    logs: Logs,
    distance: Distance = 1.0,
    heading: Heading = 45.0,
    path_gap: PathGap = 20.0,
    index_gap: IndexGap = 1,
    rounds: Rounds = 50,
    most: Annotated[
        int, typer.Option("--pairs", min=20, help="Largest number of pairs of each class.")
    ] = 1500,
    seed: Seed = 0,
    json_file: JsonFile = None,
) -> None:
    """Show for each log which features tell its places apart, how many stumps are enough, and how repetitive it is.

    Test 1: the features of the first five rounds. Test 2: the features whose removal costs most. After the tests it
    prints training and validation error by rounds, and the features that do not differ between places.
    """
    from evaluation.loops.loops_data import Reading, read_recording
    from evaluation.loops.loops_judging import look_into
    from loop_closure.places.pairs import PairRule
    from whereabouts.system.progress import track

    rule = PairRule(distance, path_gap, math.radians(heading), index_gap=index_gap)
    results = []
    for log in track(logs, "inspecting"):
        recording = read_recording(log, Reading(local_map=0.0))
        found = look_into(recording, rule, rounds, most, seed)
        results.append(found)
        typer.echo(f"{found['name']}: {found['positives']} positive and {found['negatives']} negative pairs")
        typer.echo(f"  test 1, chosen first:       {found['chosen_first']}")
        removed = ", ".join(f"{feature} ({error:.2f} %)" for feature, error in found["missed_most"])
        typer.echo(f"  test 2, missed most:        {removed}")
        errors = ", ".join(f"{t}: {a:.1f}/{b:.1f}" for t, a, b in found["error_by_rounds"])
        typer.echo(f"  error by rounds, %:         {errors}")
        typer.echo(f"  alike at different places:  {found['repetitive']}")
    write_figures(json_file, {"results": results})


def _method(method: str) -> str:
    from estimation.errors import InputError

    if method not in ("plain", "best"):
        raise InputError(f"--method: plain or best expected, got {method!r}")
    return method


def _numbers(text: str) -> list[float]:
    from estimation.errors import InputError

    try:
        return [float(part) for part in text.split(",")]
    except ValueError as error:
        raise InputError(f"--distances: numbers with commas expected, got {text!r}") from error


def _model(name: str, recordings: list[Recording]) -> PlaceModel:
    from loop_closure.places.place_model import PlaceModel, shipped_model

    if name in ("best", "plain"):
        return shipped_model(f"{name}_{recordings[0].dimension}d")
    return PlaceModel.load(name)
