"""`whereabouts intentions`: learn and predict from recorded trajectories, without ROS."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from whereabouts.cli.common import JsonFile, argument, file_to_write, option, write_figures
from whereabouts.system.counting import counted

Source = Annotated[
    Path,
    argument(
        "FILE",
        "Trajectories: Edinburgh Informatics Forum, ETH obsmat, or CSV with the columns time, label, x, y.",
    ),
]
Method = Annotated[
    str,
    option(
        "--method",
        "routes (default); ghmm: the plain growing hidden Markov model; printed: with the paths of chapter 4.",
    ),
]
Horizon = Annotated[float, option("--horizon", "Seconds to look ahead.", min=0.1, max=60.0)]
Radius = Annotated[
    float, option("--radius", "Distance to the exit that counts as correct, in metres.", min=0.01)
]
Load = Annotated[Path | None, option("--load", "Continue with a saved model.", metavar="M.npz")]
SaveOption = Annotated[Path | None, file_to_write("--save", "M.npz", "Save the model to this file.")]
Picture = Annotated[
    Path | None, file_to_write("--picture", "P.png", "Draw the learned walks and the predictions.")
]


def intentions(
    source: Source,
    method: Method = "routes",
    horizon: Horizon = 4.8,
    radius: Radius = 0.716,
    load: Load = None,
    save: SaveOption = None,
    picture: Picture = None,
    json_file: JsonFile = None,
) -> None:
    """Predict recorded walks one by one. Learn each walk after its prediction.

    It prints how often the predicted exit was right, after different parts of a walk. It also prints the error of the
    predicted path, and that of constant velocity for comparison. Walks that it does not learn are counted by reason.
    """
    from dataclasses import replace

    from evaluation.intentions.intentions_run import learn_and_predict
    from evaluation.intentions.trajectories import read_trajectories
    from tracking.intentions import IntentionConfig, IntentionModel
    from whereabouts.system.progress import progress_bar

    recorded = read_trajectories(source)
    for line in recorded.summary.lines():
        typer.echo(line, err=True)
    model: IntentionModel
    if load is not None:
        model = IntentionModel.load(load)
    else:
        model = IntentionModel.of(replace(IntentionConfig(), method=method))
    with progress_bar() as bar:
        task = bar.add_task(f"learning {source.name}", total=len(recorded.trajectories))
        told = learn_and_predict(
            model, list(recorded.trajectories.values()), horizon, radius, lambda: bar.advance(task)
        )
    walks = counted(len(recorded.trajectories), "trajectory", "trajectories")
    typer.echo(
        f"{walks} ({recorded.kind}), {told.taught} learned, "
        f"{model.learned} in the model ({model.config.method})"
    )
    for reason, count in sorted(told.refused.items()):
        typer.echo(f"{count} taught nothing: {reason}")
    for reason, count in sorted(told.dropped.items()):
        typer.echo(f"{counted(count, 'observation')} left out: {reason}")
    for fraction, rate in told.correct.items():
        typer.echo(f"correct exit after {100 * fraction:3g} %: {rate:.3f} of {told.predictions}")
    if told.moments:
        typer.echo(
            f"error after {horizon:g} s: {told.error:.3f} m, constant velocity {told.constant:.3f} m, "
            f"{counted(told.moments, 'moment')}"
        )
    if save is not None:
        typer.echo(f"saved to {model.save(save)}")
    if picture is not None:
        from evaluation.intentions.intentions_run import draw

        typer.echo(f"drawn to {draw(model, list(recorded.trajectories.values()), picture)}")
    write_figures(json_file, {"source": str(source), "method": model.config.method, **told.figures()})
