"""Entry point of the `whereabouts` command."""

from __future__ import annotations

import sys

import typer

from estimation.errors import WhereaboutsError
from whereabouts.cli.ask import ask
from whereabouts.cli.convert import convert
from whereabouts.cli.demo import demo
from whereabouts.cli.experiment import experiment
from whereabouts.cli.intentions import intentions
from whereabouts.cli.loops import app as loops
from whereabouts.cli.mcp import mcp
from whereabouts.cli.odometry import odometry
from whereabouts.cli.run import run
from whereabouts.cli.security import security
from whereabouts.cli.segment import segment
from whereabouts.cli.short import find, forget, load_map, save_map
from whereabouts.cli.slam import slam
from whereabouts.cli.track import track
from whereabouts.cli.view import view
from whereabouts.cli.world import world
from whereabouts.interrupts import listen_to_interrupts

NEEDS_EVALUATION = (
    "this command needs the package whereabouts-evaluation: in a checkout `pip install ./evaluation`, or use the "
    "environment that `make demo` sets up"
)
app = typer.Typer(
    name="whereabouts",
    help="Perception for a mobile service robot: run the nodes, and process recordings.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
for command in (
    demo, run, ask, find, forget, save_map, load_map, mcp, convert, odometry, experiment, intentions, security, segment,
    slam, track, view, world,
):  # fmt: skip
    app.command()(command)
app.add_typer(loops, name="loops")


def main() -> None:
    """Run the command line; an expected error is one sentence and exit code 1."""
    listen_to_interrupts()
    try:
        app()
    except WhereaboutsError as error:
        print(f"whereabouts: {error}", file=sys.stderr)
        sys.exit(1)
    except ImportError as error:
        package = (error.name or "").partition(".")[0]
        if package == "evaluation":
            print(f"whereabouts: {NEEDS_EVALUATION}", file=sys.stderr)
            sys.exit(1)
        if package != "rclpy" and not package.endswith("_msgs"):
            raise
        print(
            f"whereabouts: this command needs ROS 2, and {package} is not installed here: "
            "use the environment that `make demo` sets up, or source a ROS 2 workspace that has it",
            file=sys.stderr,
        )
        sys.exit(1)
    except BrokenPipeError:
        # The reader of our output has gone, as `| head` does.
        sys.exit(0)


if __name__ == "__main__":
    main()
