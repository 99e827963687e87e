"""`whereabouts loops`: train, judge and look into what tells one place from another, on logs with poses."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from evaluation.cli.experiment_command import Dask
from whereabouts.cli.common import JsonFile, argument, file_to_write, option, write_figures

if TYPE_CHECKING:
    from evaluation.loops.place_training import Recording
    from loop_closure.places.place_model import PlaceModel

app = typer.Typer(help="Train, evaluate and inspect the loop-closure classifier.", no_args_is_help=True)


Logs = Annotated[
    list[str],
    argument(
        "LOG...",
        "Logs with poses (any readable log), or a .csv of 3D features. LOG@PLACE names the building.",
    ),
]
Method = Annotated[str, option("--method", "plain: the reference's AdaBoost. best: the cascade.")]
Distance = Annotated[
    float, option("--distance", "Scans within this distance show the same place, in metres.", min=0.01)
]
Heading = Annotated[
    float, option("--heading", "Largest difference of the headings, in degrees.", min=1.0, max=180.0)
]
PathGap = Annotated[
    float, option("--path-gap", "Shortest path between the two scans of a pair, in metres.", min=0.0)
]
IndexGap = Annotated[
    int, option("--index-gap", "Fewest places of the log between the two scans of a pair.", min=1)
]
Apart = Annotated[
    float,
    option(
        "--apart",
        "Scans farther apart than this show different places, in metres; 0: use --distance.",
        min=0.0,
    ),
]
Neighbours = Annotated[bool, option("--neighbours", "Allow positive pairs that are near along the path.")]
LocalMapLength = Annotated[
    float, option("--local-map", "Length of path in a local map, in metres; 0 uses single scans.", min=0.0)
]
Rounds = Annotated[int, option("--rounds", "Number of decision stumps of the plain method.", min=1)]
Negatives = Annotated[int, option("--negatives", "Number of negative pairs from each log.", min=10)]
Jobs = Annotated[int, option("--jobs", "Number of processes.", min=1)]
Seed = Annotated[int, option("--seed", "Random seed.")]


Out = Annotated[Path, file_to_write("--out", "model.json", "File for the model.")]
Simulation = Annotated[
    int, option("--simulation", "Number of simulated office floors to add to the training data.", min=0)
]
Pairs = Annotated[int, option("--pairs", "Number of positive pairs from each log, for the cascade.", min=50)]
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
    str, option("--model", "Model file, or a shipped model: best or plain. Ignored with --protocol.")
]
Protocol = Annotated[
    str,
    option(
        "--protocol",
        "model: evaluate --model. cross: train on the other buildings. k-fold: train within each log.",
    ),
]
DistancesOption = Annotated[str, option("--distances", "Distances to evaluate at, in metres.")]
Positives = Annotated[int, option("--positives", "Largest number of positive pairs.", min=10)]
Repetitions = Annotated[int, option("--repetitions", "Number of permutations for k-fold.", min=1)]
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
    folds: Annotated[int, option("--folds", "Number of folds for k-fold.", min=2)] = 10,
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
    most: Annotated[int, option("--pairs", "Largest number of pairs of each class.", min=20)] = 1500,
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
