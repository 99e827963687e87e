"""`whereabouts view`: a running suite or a bag in Rerun, or as a picture."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from whereabouts.cli.common import JsonFile, argument, file_to_write, option, write_figures
from whereabouts.system.counting import counted

if TYPE_CHECKING:
    from whereabouts.viewer.picture_sink import PictureSink
    from whereabouts.viewer.rerun_sink import RerunSink
    from whereabouts.viewer.scene import Scene


Bags = Annotated[
    list[Path] | None,
    argument(
        "[IN]...",
        "ROS bags to show together, such as one from `run --record` and its source. "
        "Default: show the running nodes.",
    ),
]
Save = Annotated[
    Path | None, file_to_write("--save", "OUT.rrd", "Write a Rerun file instead of opening a window.")
]
Picture = Annotated[
    Path | None, file_to_write("--picture", "OUT.png", "Draw the last state from above. Needs no Rerun.")
]
Until = Annotated[
    float | None, option("--until", "Stop after this many seconds of the bag, or of listening.", min=0.0)
]
Namespace = Annotated[str, option("--namespace", "Show only the robot in this namespace, such as /robot1.")]
Hide = Annotated[
    list[str] | None,
    option("--hide", "Leave out the topics that start with this. Can be repeated.", metavar="TOPIC"),
]


def view(
    bags: Bags = None,
    save: Save = None,
    picture: Picture = None,
    until: Until = None,
    namespace: Namespace = "",
    hide: Hide = None,
    json_file: JsonFile = None,
) -> None:
    """Show scans, people and their paths, the map, closures, and objects with their symbols.

    Moving beams are red. The numbers of hypotheses, objects and people are plotted over time. The window needs the
    optional package rerun-sdk (requirements/viewer.txt).
    """
    from estimation.errors import InputError

    if save is not None and picture is not None:
        raise InputError("--save and --picture exclude each other")
    if namespace and not namespace.startswith("/"):
        raise InputError(f"--namespace: must start with a slash, got {namespace!r}")
    prefix = namespace.rstrip("/")
    with _sink(save, picture) as sink:
        scene = (
            _bags(bags, sink, until, prefix, [t.lstrip("/") for t in hide or ()])
            if bags
            else _live(sink, until, prefix)
        )
    for reason, count in scene.skipped.items():
        typer.echo(f"{counted(count, 'message')} not shown: {reason}", err=True)
    target = save or picture
    typer.echo(f"{counted(scene.taken, 'message')} shown{f', written to {target}' if target else ''}")
    write_figures(json_file, {"messages": scene.taken, "skipped": scene.skipped.total()})


def _sink(save: Path | None, picture: Path | None) -> RerunSink | PictureSink:
    if picture is not None:
        from whereabouts.viewer.picture_sink import PictureSink

        return PictureSink(picture)
    from whereabouts.viewer.rerun_sink import RerunSink

    return RerunSink(save)


def _bags(bags: list[Path], sink: Any, until: float | None, namespace: str, hidden: list[str]) -> Scene:
    from whereabouts.system.progress import share_bar
    from whereabouts.viewer.playback import play

    with share_bar(f"reading {', '.join(bag.name for bag in bags)}") as share:
        return play(bags, sink, until, namespace, hidden, share)


def _live(sink: Any, until: float | None, namespace: str) -> Scene:
    from whereabouts.nodes.live.listener import listen
    from whereabouts.nodes.runtime.suite_run import prepare_environment
    from whereabouts.viewer.scene import Scene, stamp_of

    scene = Scene()

    def take(type_name: str, topic: str, message: Any, arrival: int) -> None:
        sink.draw(stamp_of(message, arrival), scene.take(type_name, topic, message))

    prepare_environment()
    typer.echo("listening; Ctrl-C ends")

    def tell(_node: Any, new: list[str]) -> None:
        for topic in new:
            typer.echo(f"showing {topic}")

    listen("whereabouts_view", scene.types, take, namespace, until, tell)
    return scene
