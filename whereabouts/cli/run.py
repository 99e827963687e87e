"""`whereabouts run`: nodes as supervised processes, on a live robot or on a bag."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

NODES = (
    "scan_registration",
    "loop_closure",
    "target_tracker",
    "motion_predictor",
    "world_model",
    "world_maintenance",
    "verifier",
    "object_search",
)


def run(
    nodes: Annotated[
        list[str] | None,
        typer.Argument(metavar="[NODE]...", help=f"Nodes to run: {', '.join(NODES)}. All by default."),
    ] = None,
    bag: Annotated[
        Path | None,
        typer.Option("--bag", help="Replay this ROS 2 bag (or ROS 1 bag) through them, then end."),
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option("--rate", min=0.01, max=1000.0, help="Replay at this multiple of the recorded speed."),
    ] = None,
    lock_step: Annotated[
        bool,
        typer.Option("--lock-step", help="Replay as fast as the nodes keep up, no message unanswered."),
    ] = False,
    record: Annotated[
        list[str] | None,
        typer.Option(
            "--record", metavar="TOPIC:TYPE", help="Record, such as odometry:nav_msgs/msg/Odometry."
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", metavar="OUT.mcap", help="Where to record to.")] = None,
    params: Annotated[
        Path | None, typer.Option("--params", help="ROS parameter file on top of the shipped ones.")
    ] = None,
    namespace: Annotated[
        str, typer.Option("--namespace", help="Namespace of all nodes, such as /robot1.")
    ] = "",
    logs: Annotated[Path, typer.Option("--logs", help="Folder for one log file per node.")] = Path(
        "log/nodes"
    ),
) -> None:
    """Run nodes, watch over them and end them cleanly on Ctrl-C.

    A node that dies is started again. With --bag the bag is replayed with /clock at --rate (default 1), or in
    lock-step; the account of messages sent, lost and unanswered is printed at the end.
    """
    from estimation.errors import InputError
    from whereabouts.nodes.suite import prepare_environment

    chosen = nodes or list(NODES)
    unknown = [name for name in chosen if name not in NODES]
    if unknown:
        raise InputError(f"no node is called {', '.join(unknown)}; there are: {', '.join(NODES)}")
    if namespace and not namespace.startswith("/"):
        raise InputError(f"--namespace: must start with a slash, got {namespace!r}")
    if (record is None) != (out is None):
        raise InputError("--record and --out go together")
    if rate is not None and lock_step:
        raise InputError("--rate and --lock-step exclude each other")
    prepare_environment()
    if bag is None:
        if record or rate or lock_step:
            raise InputError("--record, --rate and --lock-step need --bag")
        _run_live(chosen, params, namespace, logs)
    else:
        speed = None if lock_step else (rate or 1.0)
        _run_bag(chosen, bag, speed, [_recorded(text) for text in record or []], out, params, namespace, logs)


def _recorded(text: str) -> tuple[str, str]:
    from estimation.errors import InputError

    topic, _, type_name = text.rpartition(":")
    if not topic or type_name.count("/") != 2:
        raise InputError(f"--record: TOPIC:PACKAGE/msg/TYPE expected, got {text!r}")
    return topic, type_name


def _run_live(nodes: list[str], params: Path | None, namespace: str, logs: Path) -> None:
    import time

    from whereabouts.nodes.supervisor import NodeSpec, Supervisor

    with Supervisor(logs, on_event=typer.echo) as supervisor:
        for name in nodes:
            supervisor.start(NodeSpec(name, namespace, parameter_file=params))
        typer.echo(f"running {', '.join(supervisor.nodes)}; Ctrl-C ends, logs are in {logs}")
        try:
            while True:
                supervisor.check()
                time.sleep(0.2)
        except KeyboardInterrupt:
            typer.echo("ending")


def _run_bag(
    nodes: list[str],
    bag: Path,
    rate: float | None,
    record: list[tuple[str, str]],
    out: Path | None,
    params: Path | None,
    namespace: str,
    logs: Path,
) -> None:
    from whereabouts.nodes.suite import REPLAY_PARAMETERS, SuiteRun, run_suite
    from whereabouts.nodes.supervisor import NodeSpec
    from whereabouts.progress import progress_bar

    specs = [NodeSpec(name, namespace, dict(REPLAY_PARAMETERS), params) for name in nodes]
    with progress_bar() as bar:
        task = bar.add_task(f"replaying {bag.name}", total=100)
        account = run_suite(
            SuiteRun(
                bag,
                specs,
                logs,
                rate=rate,
                namespace=namespace,
                record=record,
                output=out,
                on_event=lambda text: typer.echo(text, err=True),
                on_progress=lambda share: bar.update(task, completed=round(100 * share)),
            )
        )
    for topic, reason in account.skipped.items():
        typer.echo(f"{topic}: not published: {reason}", err=True)
    typer.echo(
        f"{account.published.total()} messages over {account.bag_seconds:.1f} s in {account.wall_seconds:.1f} s, "
        f"{account.total_lost} lost, {account.unanswered.total()} unanswered"
    )
