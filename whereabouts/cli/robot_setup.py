"""Commands that get the suite ready for a robot: `setup`, `doctor`, `parameters`, `security`."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from whereabouts.cli.common import JsonFile, argument, file_to_write, option, target_folder, write_figures
from whereabouts.node_names import NODES
from whereabouts.system.counting import counted

if TYPE_CHECKING:
    from whereabouts.robot.survey import Survey

BagToLookAt = Annotated[
    Path | None, argument("[BAG]", "Any readable recording. Default: look at the running robot.")
]
Seconds = Annotated[
    float, option("--seconds", "How long to listen to a running robot, in seconds.", min=1.0, max=600.0)
]
PresetName = Annotated[
    str | None,
    option(
        "--preset",
        "A kind of robot: turtlebot3, turtlebot4, husky or scanner. What is seen goes before it. "
        "With --no-look it is written as it is.",
        metavar="NAME",
    ),
]


def setup(
    bag: BagToLookAt = None,
    out: Annotated[Path, file_to_write("--out", "robot.yaml", "Write the parameter file here.")] = Path(
        "robot.yaml"
    ),
    preset: PresetName = None,
    look: Annotated[
        bool, option("--look/--no-look", "Look at the robot or the bag; without, write the preset.")
    ] = True,
    seconds: Seconds = 5.0,
    overwrite: Annotated[
        bool, option("--overwrite", "Replace the file; without, one that exists is kept.")
    ] = False,
    json_file: JsonFile = None,
) -> None:
    """Look at a robot and write the parameters that the suite needs for it, with reasons.

    Nothing is written if something stands in the way, such as a frame with two parents: it says what to do about it.
    The file is a ROS parameter file, for `whereabouts run --config`, for launch files, and for `--params`.
    """
    from estimation.errors import InputError
    from whereabouts.robot.choice import choose
    from whereabouts.robot.findings import findings
    from whereabouts.robot.preset import preset as preset_of
    from whereabouts.robot.robot_file import as_text, parameters
    from whereabouts.robot.survey import Survey
    from whereabouts.system.atomic import write_text
    from whereabouts.system.log_errors import WriteError

    if out.exists() and not overwrite:
        raise WriteError(out, "exists and was kept; --overwrite replaces it, --out names another file")
    wanted = None if preset is None else preset_of(preset)
    if not look and wanted is None:
        raise typer.BadParameter("--no-look needs --preset")
    survey = survey_of(bag, seconds) if look else Survey(f"the preset {preset}")
    choice = choose(survey, wanted)
    said = findings(survey, choice) if look else []
    for finding in said:
        typer.echo(str(finding), err=finding.level == "error")
    errors = sum(finding.level == "error" for finding in said)
    write_figures(json_file, {"parameters": parameters(choice), "findings": [vars(item) for item in said]})
    if errors:
        raise InputError(
            f"{out} was not written: {counted(errors, 'thing stands', 'things stand')} in the way"
        )
    write_text(out, as_text(choice, said, survey.source, shlex.quote(out.name)))
    bag_option = f" --bag {shlex.quote(str(bag))}" if bag is not None else ""
    space = f" --namespace {choice.namespace}" if choice.namespace else ""
    typer.echo(f"written: {out}. Next: whereabouts run --config {shlex.quote(str(out))}{space}{bag_option}")


def survey_of(bag: Path | None, seconds: float) -> Survey:
    """What there is in a bag, or on the graph."""
    if bag is not None:
        from whereabouts.robot.bags import survey_bag

        return survey_bag(bag)
    from whereabouts.nodes.live.graph_survey import survey_graph
    from whereabouts.nodes.runtime.suite_run import prepare_environment

    prepare_environment()
    typer.echo(f"listening for {seconds:g} s")
    return survey_graph(seconds)


def doctor(
    bag: BagToLookAt = None, preset: PresetName = None, seconds: Seconds = 5.0, json_file: JsonFile = None
) -> None:
    """Say what is wrong with a robot or a recording, what the suite would use, and what to do.

    It names frames with two parents, transforms with two publishers, clocks that are apart, QoS that does not fit,
    what running nodes of the suite drop and why, and where the libraries are imported from. Exit status 1 for an error.
    """
    from whereabouts.robot.choice import choose
    from whereabouts.robot.findings import findings
    from whereabouts.robot.imports import import_findings, origins
    from whereabouts.robot.preset import preset as preset_of

    # What is wrong with the bag or the preset is said plainly, with nothing before it.
    wanted = None if preset is None else preset_of(preset)
    survey = survey_of(bag, seconds)
    choice = choose(survey, wanted)
    places = origins()
    for name, place in places.items():
        typer.echo(f"{name}: {place}")
    said = [*import_findings(places), *findings(survey, choice)]
    typer.echo(
        f"frames: map '{choice.map_frame}', odometry '{choice.odom_frame}', robot '{choice.base_frame}'; "
        f"scans {', '.join(choice.scans) or 'none'}, clouds {', '.join(choice.clouds) or 'none'}, "
        f"wheels {choice.wheels or 'none'}"
    )
    for finding in said:
        typer.echo(str(finding))
    errors, warnings = (sum(finding.level == level for finding in said) for level in ("error", "warning"))
    typer.echo(f"{counted(errors, 'error')}, {counted(warnings, 'warning')}")
    write_figures(json_file, {"imports": places, "findings": [vars(item) for item in said]})
    if errors:
        raise typer.Exit(1)


def parameters(
    nodes: Annotated[
        list[str] | None, argument("[NODE]...", f"Of these nodes: {', '.join(NODES)}. Default: all.")
    ] = None,
    expert: Annotated[
        bool, option("--expert", "Those that hardly anybody changes, in place of the usual ones.")
    ] = False,
    out: Annotated[
        Path | None, file_to_write("--out", "FILE", "Write them here; default: print them.")
    ] = None,
) -> None:
    """Write a ROS parameter file with the defaults, and the meaning, unit and range of each parameter."""
    from estimation.errors import InputError
    from whereabouts.parameters.yaml_text import parameter_file
    from whereabouts.system.atomic import write_text

    unknown = [name for name in nodes or () if name not in NODES]
    if unknown:
        raise InputError(f"no node is called {', '.join(unknown)}; there are: {', '.join(NODES)}")
    text = parameter_file(nodes or NODES, expert)
    if out is None:
        typer.echo(text, nl=False)
        return
    write_text(out, text)
    typer.echo(
        f"{out}: {'expert parameters' if expert else 'parameters'} of {counted(len(nodes or NODES), 'node')}"
    )


def security(
    out: Annotated[Path, option("--out", "Folder for the policies, one file each.", callback=target_folder)],
    config: Annotated[
        Path | None, option("--config", "The suite's file, as of `whereabouts run --config`.")
    ] = None,
) -> None:
    """Write least-privilege SROS2 policies: one for each node, one for clients and one for operators.

    docs/security.md says how to use them.
    """
    from whereabouts.sros2_policies import write_policies
    from whereabouts.suite_config import read_config

    for path in write_policies(read_config(config, {}), out):
        typer.echo(str(path))
