"""`whereabouts doctor`: what stands in the way of the suite on a robot, and where its packages come from."""

from __future__ import annotations

import typer

from whereabouts.cli.common import JsonFile, write_figures
from whereabouts.cli.setup import BagToLookAt, PresetName, Seconds, survey_of
from whereabouts.system.counting import counted


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
