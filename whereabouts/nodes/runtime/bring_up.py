"""Brings lifecycle nodes up in order: all are configured before the first is activated.

`whereabouts run` uses `bring_up`; launch files run the executable `bring_up`, which ends when all nodes are active, or,
with `--watch`, stays and brings up those that were started again.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

import rclpy
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.utilities import remove_ros_args

from whereabouts.nodes.runtime.supervisor import SuiteError
from whereabouts.system.interrupts import interrupts_kept, listen_to_interrupts

# s until a node has to be there, and until one that is there has to be active: a very first start compiles, which on a
# small computer, with all nodes at once, takes many minutes.
TIMEOUT, COMPILING = 180.0, 1800.0
SAY_AFTER = 20.0
ANSWER_TIMEOUT = 30.0
WATCH_PERIOD = 2.0
STEPS = {
    State.PRIMARY_STATE_UNCONFIGURED: (Transition.TRANSITION_CONFIGURE, "configured"),
    State.PRIMARY_STATE_INACTIVE: (Transition.TRANSITION_ACTIVATE, "activated"),
}


class LifecycleClient:
    """State of one node, and the way to change it."""

    def __init__(self, node: Node, executor: Any, name: str) -> None:
        self.name = name
        self._node, self._executor = node, executor
        self._get = node.create_client(GetState, f"{name}/get_state")
        self._change = node.create_client(ChangeState, f"{name}/change_state")
        # By the state that the step is from, steps whose answers are to come.
        self._asked: dict[int, Any] = {}

    @property
    def present(self) -> bool:
        """Whether the node is there, although it may be too busy to answer."""
        return bool(self._get.service_is_ready())

    def processes(self) -> frozenset[bytes]:
        """Ids of the processes that are, or a moment ago were, this node: one that was started again has a new one."""
        infos = self._node.get_publishers_info_by_topic(f"{self.name}/transition_event")
        return frozenset(bytes(info.endpoint_gid) for info in infos)

    def state(self, wait: float = 1.0) -> int:
        """A number of lifecycle_msgs/State; PRIMARY_STATE_UNKNOWN where nobody answers in time."""
        answer = self._call(self._get, GetState.Request(), wait)
        return State.PRIMARY_STATE_UNKNOWN if answer is None else int(answer.current_state.id)

    def ask(self, state: int) -> None:
        """Begin the step that follows `state`; `advance` waits for its end."""
        if self._change.service_is_ready():
            self._asked[state] = self._change.call_async(_step_from(state))

    def advance(self, state: int) -> None:
        """Take the step that follows `state` on the way to active.

        Raises SuiteError: the node refused, and has not gone on by itself.
        """
        answer = self._call(self._change, _step_from(state), ANSWER_TIMEOUT, self._asked.pop(state, None))
        if answer is not None and not answer.success and self.state() == state:
            raise SuiteError(f"{self.name} could not be {STEPS[state][1]}; its log says why")

    def _call(self, client: Any, request: Any, wait: float, asked: Any = None) -> Any:
        with interrupts_kept():
            if not client.service_is_ready():
                self._executor.spin_once(timeout_sec=0.05)
                return None
            future = asked or client.call_async(request)
            self._executor.spin_until_future_complete(future, timeout_sec=wait)
            if not future.done():
                client.remove_pending_request(future)
                return None
            return future.result()


def _step_from(state: int) -> Any:
    request = ChangeState.Request()
    request.transition.id = STEPS[state][0]
    return request


def bring_up(
    clients: Sequence[LifecycleClient],
    look_after: Callable[[], None] = lambda: None,
    timeout: float = TIMEOUT,
    tell: Callable[[str], None] = lambda text: None,
) -> None:
    """Configure all nodes, then activate them in order. One that is further already is left as it is.

    look_after : called again and again while waiting; may raise. timeout : s until a node has to be there. tell :
    called with a sentence if a node takes long.
    Raises SuiteError: a node refuses, is not there in time, or is there and not active for `COMPILING`.
    """
    wait = _Wait(timeout, tell)
    for client in clients:
        # All configure themselves at once: each has a lot to set up.
        while (state := client.state()) == State.PRIMARY_STATE_UNKNOWN:
            look_after()
            wait.check(client)
        if state == State.PRIMARY_STATE_UNCONFIGURED:
            client.ask(state)
    for enough in ((State.PRIMARY_STATE_INACTIVE, State.PRIMARY_STATE_ACTIVE), (State.PRIMARY_STATE_ACTIVE,)):
        for client in clients:
            while (state := client.state()) not in enough:
                look_after()
                wait.check(client)
                if state in STEPS:
                    client.advance(state)


class _Wait:
    """How long nodes are waited for."""

    def __init__(self, timeout: float, tell: Callable[[str], None]) -> None:
        self._begun = self._seen = time.monotonic()
        self._timeout, self._tell = timeout, tell
        self._told = False

    def check(self, client: LifecycleClient) -> None:
        """Raises SuiteError for a node that has not been there for too long."""
        now = time.monotonic()
        if client.present:
            self._seen = now
        waited, missed = now - self._begun, now - self._seen
        if waited > COMPILING or missed > self._timeout:
            raise SuiteError(f"{client.name} is not active after {waited:.0f} s; its log says why")
        if waited > SAY_AFTER and client.present and not self._told:
            self._told = True
            self._tell(
                f"waiting for {client.name}: the first start after an installation compiles; "
                "`python3 -m whereabouts.compile` does it beforehand"
            )


@contextmanager
def lifecycle_clients(names: Sequence[str], arguments: Sequence[str] = ()) -> Iterator[list[LifecycleClient]]:
    """Clients of nodes, from a ROS context of their own; names without a slash are taken in its namespace."""
    context = Context()
    rclpy.init(args=list(arguments), context=context)
    node = Node("bring_up", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    prefix = node.get_namespace().rstrip("/")
    try:
        yield [
            LifecycleClient(node, executor, name if name.startswith("/") else f"{prefix}/{name}")
            for name in names
        ]
    finally:
        node.destroy_node()
        context.try_shutdown()


def watch(clients: Sequence[LifecycleClient]) -> None:
    """Bring up, for ever, what was started again. What a person deactivates stays as it is."""
    known: dict[str, frozenset[bytes]] = {client.name: frozenset() for client in clients}
    while True:
        for client in clients:
            processes = client.processes()
            if processes - known[client.name]:
                # One that died before it was looked at for the first time is unconfigured already.
                again = client.state() in STEPS
                bring_up([client])
                if again:
                    print(f"{client.name} was started again", flush=True)
            known[client.name] = processes
        time.sleep(WATCH_PERIOD)


def main() -> None:
    """The executable: `bring_up [--watch] NODE...`."""
    parser = argparse.ArgumentParser(prog="bring_up", description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("nodes", nargs="+", metavar="NODE", help="lifecycle nodes to bring up, in order")
    parser.add_argument(
        "--watch", action="store_true", help="keep running, and bring up nodes that start again"
    )
    listen_to_interrupts()
    given = parser.parse_args(remove_ros_args(sys.argv)[1:])
    try:
        with lifecycle_clients(given.nodes, arguments=sys.argv) as clients:
            if given.watch:
                watch(clients)
            bring_up(clients, tell=partial(print, flush=True))
            print(f"{', '.join(client.name for client in clients)}: active", flush=True)
    except SuiteError as error:
        print(f"bring_up: {error}", file=sys.stderr)
        sys.exit(1)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass


if __name__ == "__main__":
    main()
