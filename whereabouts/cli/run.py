"""`whereabouts run`: nodes as supervised processes, on a live robot or on a bag."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from whereabouts.cli.common import Namespace, argument, file_to_write, option, target_file, target_folder
from whereabouts.compiled_cache import is_compiled
from whereabouts.node_names import NODES
from whereabouts.system.counting import counted

if TYPE_CHECKING:
    from whereabouts.nodes.ros.host import Host
    from whereabouts.nodes.runtime.supervisor import NodeSpec
    from whereabouts.suite_config import SuiteConfig

__all__ = ["NODES", "run"]


NodesOption = Annotated[
    list[str] | None, argument("[NODE]...", f"Nodes to run: {', '.join(NODES)}. Default: all.")
]
Config = Annotated[
    Path | None,
    option(
        "--config",
        "YAML file with nodes, parameters, remappings, namespace and bag. Options override it.",
        metavar="suite.yaml",
    ),
]
Bag = Annotated[Path | None, option("--bag", "Replay this ROS 1 or ROS 2 bag through the nodes, then end.")]
Rate = Annotated[
    float | None, option("--rate", "Replay speed, as a multiple of the recorded speed.", min=0.01, max=1000.0)
]
LockStep = Annotated[
    bool, option("--lock-step", "Replay as fast as the nodes can; wait for each message to be processed.")
]
Record = Annotated[
    list[str] | None,
    option(
        "--record",
        "Topic to record, such as odometry:nav_msgs/msg/Odometry. Can be repeated.",
        metavar="TOPIC:TYPE",
    ),
]
Out = Annotated[Path | None, file_to_write("--out", "OUT.mcap", "File for the recording.")]
Params = Annotated[Path | None, option("--params", "ROS parameter file. It overrides the shipped ones.")]
Logs = Annotated[
    Path | None,
    option(
        "--logs",
        "Folder for one log file per node.",
        show_default="whereabouts in ROS's folder of logs",
        callback=target_folder,
    ),
]


def run(
    nodes: NodesOption = None,
    config: Config = None,
    bag: Bag = None,
    rate: Rate = None,
    lock_step: LockStep = False,
    record: Record = None,
    out: Out = None,
    params: Params = None,
    namespace: Namespace = "",
    logs: Logs = None,
) -> None:
    """Run nodes and end them cleanly on Ctrl-C.

    All nodes are configured at once, then activated in order. A node that dies is started again. With --bag the bag is
    replayed with /clock at --rate (default 1), or in lock-step. At the end it prints how many messages were
    sent, lost and not processed. The replay has a ROS domain of its own on this machine, unless ROS_DOMAIN_ID is set.
    """
    from whereabouts.nodes.ros.host import Host

    # It has much to load: meanwhile the rest is imported, and what to run is read.
    host = None if nodes and len(nodes) == 1 else Host.early()

    from whereabouts.nodes.runtime.suite_run import prepare_environment
    from whereabouts.suite_config import read_config

    options: dict[str, Any] = {
        "bag": bag,
        "rate": rate,
        "lock_step": lock_step,
        "record": dict(map(_recorded, record or ())),
        "out": out,
        "params_file": params,
        "namespace": namespace,
        "logs": logs,
    }
    options = {key: value for key, value in options.items() if value}
    chosen = read_config(config, options).only(nodes or [])
    if host is not None and len(chosen.nodes) == 1:
        host.end()
        host = None
    target_folder(chosen.logs)
    if chosen.out is not None and chosen.out.suffix == ".mcap":
        target_file(chosen.out)
    root = Path(__file__).parents[2]
    if not is_compiled(root) and os.access(root, os.W_OK):
        typer.echo(
            "nothing is compiled yet, so that the nodes start after minutes: `python3 -m whereabouts.compile` "
            "compiles once and for all",
            err=True,
        )
    # A bag must not mix with a robot, nor with another bag.
    prepare_environment(private=chosen.bag is not None)
    if chosen.bag is None:
        _run_live(chosen, host)
    else:
        _run_bag(chosen, chosen.bag, host)


def _recorded(text: str) -> tuple[str, str]:
    from estimation.errors import InputError

    topic, _, type_name = text.rpartition(":")
    if not topic or type_name.count("/") != 2:
        raise InputError(f"--record: TOPIC:PACKAGE/msg/TYPE expected, got {text!r}")
    return topic, type_name


def _specs(config: SuiteConfig, **above: Any) -> list[NodeSpec]:
    """What to start, in order; `above` are parameters below those of the nodes themselves."""
    from whereabouts.nodes.runtime.supervisor import NodeSpec

    return [
        NodeSpec(
            name,
            config.namespace,
            {**above, **node.parameters},
            node.params_file or config.params_file,
            node.remappings,
        )
        for name, node in config.nodes.items()
    ]


def _run_live(config: SuiteConfig, host: Host | None) -> None:
    import time
    from dataclasses import replace

    from whereabouts.nodes.runtime.bring_up import bring_up, lifecycle_clients
    from whereabouts.nodes.runtime.log_echo import LogEcho
    from whereabouts.nodes.runtime.supervisor import Supervisor

    echo = LogEcho(lambda text: typer.echo(text, err=True))
    several = len(config.nodes) > 1
    with Supervisor(config.logs, on_event=typer.echo, patient=True, hosted=several, host=host) as supervisor:
        try:
            # Those that shall not configure themselves are somebody else's to bring up.
            managed = []
            for spec in _specs(config):
                if spec.parameters.get("autostart", True):
                    managed.append(spec)
                    spec = replace(spec, parameters={**spec.parameters, "autostart": False})
                supervisor.start(spec)
            typer.echo(f"starting {', '.join(supervisor.nodes)}; Ctrl-C ends, logs are in {config.logs}")
            with lifecycle_clients([spec.full_name for spec in managed]) as clients:
                bring_up(clients, supervisor.check, tell=typer.echo)
            for spec in managed:
                # One that dies from now on comes back by itself.
                supervisor.nodes[spec.full_name].spec = spec
            typer.echo("all are active")
            while True:
                supervisor.check()
                echo.look(node.log for node in supervisor.nodes.values())
                time.sleep(0.2)
        except KeyboardInterrupt:
            typer.echo("ending")


def _run_bag(config: SuiteConfig, bag: Path, host: Host | None) -> None:
    from whereabouts.logs import open_raw
    from whereabouts.nodes.runtime.log_echo import LogEcho
    from whereabouts.nodes.runtime.suite_run import REPLAY_PARAMETERS, SuiteRun, run_suite
    from whereabouts.system.progress import share_bar

    echo = LogEcho(lambda text: typer.echo(text, err=True))
    domain = os.environ["ROS_DOMAIN_ID"]
    log = open_raw(bag)
    typer.echo(f"replaying on ROS domain {domain}: set ROS_DOMAIN_ID={domain} to look at it")
    with share_bar(f"replaying {bag.name}") as share:
        suite = SuiteRun(
            log,
            _specs(config, **REPLAY_PARAMETERS),
            config.logs,
            rate=None if config.lock_step else (config.rate or 1.0),
            namespace=config.namespace,
            record=list(config.record.items()),
            output=config.out,
            host=host,
            on_event=lambda text: typer.echo(text, err=True),
            on_progress=share,
        )

        def listen(now: bool = False) -> None:
            if suite.supervisor is not None:
                echo.look((node.log for node in suite.supervisor.nodes.values()), now)

        suite.on_message = lambda message: listen()
        account = run_suite(suite)
        listen(now=True)
    for name, topics in account.deaf.items():
        more = " and others" if len(topics) > 3 else ""
        typer.echo(f"{name}: nothing came on {', '.join(topics[:3])}{more}", err=True)
    for topic, reason in account.skipped.items():
        typer.echo(f"{topic}: not published: {reason}", err=True)
    typer.echo(
        f"{counted(account.published.total(), 'message')} over {account.bag_seconds:.1f} s in "
        f"{account.wall_seconds:.1f} s, {account.total_lost} lost, {account.unanswered.total()} unanswered"
    )
