"""What the running node `world_model` knows, for questions: from its store where that is on this machine, else its
newest `world_state`."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rcl_interfaces.srv import GetParameters

from estimation.errors import WhereaboutsError
from estimation.geometry.places import Places
from whereabouts.messages.world_objects import state_from_message
from whereabouts.nodes.ros.executor import leave, private_node
from whereabouts.nodes.ros.qos import LATCHED
from whereabouts.nodes.runtime.suite_run import prepare_environment
from whereabouts.system.interrupts import interrupts_kept
from whereabouts_msgs.msg import WorldState as StateMessage
from world_model.memory.store import Store
from world_model.questions import Recall
from world_model.symbols import Symbols, default_symbols

PATIENCE = 5.0
"""s in which a node that runs answers."""
NODE = "world_model"
SAME_STAMP = 1e-3
"""s between stamps that are the same, one of them rounded."""


class NoWorldError(WhereaboutsError):
    """No node `world_model` answers."""


class Client:
    """A node of this process that talks to the running suite. namespace : "" or "/robot1"."""

    def __init__(self, namespace: str = "") -> None:
        prepare_environment()
        self.node, self._executor = private_node("whereabouts_client", namespace)

    def close(self) -> None:
        leave(self.node)

    def until(self, done: Callable[[], bool], seconds: float = PATIENCE) -> bool:
        """Spin until it is done or the time is over; returns whether it is done."""
        end = time.monotonic() + seconds
        while not done() and time.monotonic() < end:
            self.spin()
        return done()

    def spin(self) -> None:
        with interrupts_kept():
            self._executor.spin_once(timeout_sec=0.05)

    def call(self, kind: Any, name: str, request: Any, seconds: float = PATIENCE) -> Any:
        """The answer of a service. seconds : that it may take. Raises NoWorldError where nobody answers."""
        client = self.node.create_client(kind, name)
        try:
            if not self.until(client.service_is_ready):
                raise NoWorldError(
                    f"nobody offers {name}: start the suite with `whereabouts run`{self.elsewhere(name)}"
                )
            future = client.call_async(request)
            if not self.until(future.done, seconds):
                raise NoWorldError(f"{name} does not answer within {seconds:g} s")
            return future.result()
        finally:
            self.node.destroy_client(client)

    def state(self) -> StateMessage:
        """The newest world. Raises NoWorldError where nobody says it."""
        heard: list[StateMessage] = []
        subscription = self.node.create_subscription(StateMessage, "world_state", heard.append, LATCHED)
        self.until(lambda: bool(heard))
        self.node.destroy_subscription(subscription)
        if not heard and self.node.count_publishers("world_state"):
            raise NoWorldError(
                "the world model runs, but nothing has been seen yet: it waits for evidence, detections or targets; "
                "`whereabouts doctor` tells of trouble"
            )
        if not heard:
            raise NoWorldError(
                "no live world: nobody says world_state; start the suite with `whereabouts run world_model`, or name a "
                "store: `ask world.sqlite ...`, or `--store world.sqlite` with other commands"
                f"{self.elsewhere('world_state')}"
            )
        return heard[-1]

    def elsewhere(self, name: str) -> str:
        """How to reach a topic or service of a name that is offered in other namespaces; empty where it is not."""
        offered = [*self.node.get_topic_names_and_types(), *self.node.get_service_names_and_types()]
        spaces = {full.removesuffix(f"/{name}") for full, _ in offered if full.endswith(f"/{name}")}
        others = sorted(spaces - {self.node.get_namespace().rstrip("/")})
        ways = [f"with --namespace {space}" if space else "without --namespace" for space in others]
        return f". There is one {' or '.join(ways)}" if ways else ""

    def parameters(self, *names: str) -> list[str]:
        """Text parameters of the node `world_model`; "" where it has none."""
        request = GetParameters.Request(names=list(names))
        answer = self.call(GetParameters, f"{NODE}/get_parameters", request)
        return [value.string_value for value in answer.values] or [""] * len(names)


@contextmanager
def live_world(client: Client, places: Places | None = None) -> Iterator[Recall]:
    """What the node `world_model` knows. places : in place of its own. Raises NoWorldError where it says nothing."""
    message = client.state()
    path, places_file, symbols_file = client.parameters("store_path", "places_file", "predicates_file")
    if places is None and places_file and Path(places_file).is_file():
        places = Places.load(places_file)
    symbols = (
        Symbols.load(symbols_file) if symbols_file and Path(symbols_file).is_file() else default_symbols()
    )
    state = state_from_message(message)
    if path and Path(path).is_file():
        with Store(path, read_only=True) as store:
            # A relative path, or one of another machine, may lead to another file here.
            epoch, stamp, _ = store.newest()
            if epoch == state.epoch and (stamp or 0.0) > state.stamp - SAME_STAMP:
                yield Recall.of_store(store, places, symbols)
                return
    present = {item.id: item for item in state.objects}
    yield Recall(state.stamp, state.epoch, present, places or Places(), symbols)
