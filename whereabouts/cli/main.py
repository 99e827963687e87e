"""Entry point of the `whereabouts` command."""

from __future__ import annotations

import importlib
import sys
from typing import Annotated, NoReturn

import typer

from estimation.errors import WhereaboutsError
from whereabouts import __version__
from whereabouts.cli.ask import ask
from whereabouts.cli.common import option
from whereabouts.cli.console import console
from whereabouts.cli.convert import convert
from whereabouts.cli.mcp import mcp
from whereabouts.cli.odometry_command import odometry
from whereabouts.cli.robot_setup import doctor, parameters, security, setup
from whereabouts.cli.run import run
from whereabouts.cli.segment import segment
from whereabouts.cli.short import find, forget, load_map, save_map
from whereabouts.cli.slam_command import merge, slam
from whereabouts.cli.track import track
from whereabouts.cli.view_command import view
from whereabouts.cli.world_command import world
from whereabouts.system.interrupts import listen_to_interrupts

# What to install for a package that is missing, by the package. ROS's own are told apart by their names.
EXTRAS = {
    "evaluation": "whereabouts-evaluation: in a checkout `pip install ./evaluation`, or use the environment that "
    "`make demo` sets up",
    "gtsam": "gtsam: `pip install gtsam`",
    "small_gicp": "small_gicp: `pip install small_gicp`",
    "kiss_icp": "kiss-icp: `pip install kiss-icp`",
    "rerun": "rerun-sdk: `pip install rerun-sdk`",
}


def _say_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"whereabouts {__version__}")
        raise typer.Exit


app = typer.Typer(
    name="whereabouts", no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False
)


def _lacking() -> NoReturn:
    """Needs the package whereabouts-evaluation, which is not installed."""
    raise ModuleNotFoundError(name="evaluation")


def _add_of_evaluation(name: str) -> None:
    """A command that comes with the experiments; without them it says what to install."""
    try:
        module = importlib.import_module(f"evaluation.cli.{name}_command")
    except ModuleNotFoundError:
        app.command(name, context_settings={"ignore_unknown_options": True, "allow_extra_args": True})(
            _lacking
        )
        return
    if hasattr(module, "app"):
        app.add_typer(module.app, name=name)
    else:
        app.command()(getattr(module, name))


for command in (
    "demo", setup, doctor, parameters, run, ask, find, forget, save_map, load_map, mcp, console, view, odometry,
    slam, merge, track, segment, world, "intentions", convert, "experiment", security, "loops",
):  # fmt: skip
    if isinstance(command, str):
        _add_of_evaluation(command)
    else:
        app.command()(command)


@app.callback()
def about(
    version: Annotated[
        bool, option("--version", "Print the version and exit.", callback=_say_version, is_eager=True)
    ] = False,
) -> None:
    """Perception for a mobile service robot: run the nodes, and process recordings."""


def _missing(module: str) -> str:
    """What to say of a module that is not installed; empty for one that nobody expects to be missing."""
    # Wheels have the simulation beside the product, with the experiments.
    package = "evaluation" if module == "whereabouts.simulation" else module.partition(".")[0]
    if package in EXTRAS:
        return f"this command needs the package {EXTRAS[package]}"
    if package == "rclpy" or package.endswith("_msgs"):
        return (
            f"this command needs ROS 2, and {package} is not installed here: "
            "use the environment that `make demo` sets up, source a ROS 2 workspace that has it, or install the wheel "
            "with its extra [ros]"
        )
    return ""


def main() -> None:
    """Run the command line; an expected error is one sentence and exit code 1."""
    listen_to_interrupts()
    try:
        app()
    except BrokenPipeError:
        # The reader of our output has gone, as `| head` does.
        sys.exit(0)
    except Exception as error:
        sentence = _sentence(error)
        if not sentence:
            raise
        print(f"whereabouts: {sentence}", file=sys.stderr)
        sys.exit(1)


def _sentence(error: Exception) -> str:
    """What to say of an error that is expected; "" for others."""
    if isinstance(error, WhereaboutsError):
        return str(error)
    if isinstance(error, ImportError):
        return _missing(error.name or "")
    # Of ROS itself, such as of SROS2's keys; rclpy has no public name for it, and may not be here.
    if isinstance(error, RuntimeError) and type(error).__name__ == "RCLError":
        return f"ROS says: {' '.join(str(error).split())}"
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return ""


if __name__ == "__main__":
    main()
