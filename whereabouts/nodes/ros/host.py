"""One process from which nodes are forked: what they import and load is in memory once, and a node is there at once.

The host imports the nodes and loads their compiled functions, but nothing of ROS is started in it; each child does that
for itself, and is a process like any other: it is killed, restarted and measured alone. A child is forked twice, so
that the supervisor, which is made the one that adopts orphans, becomes its parent and can wait for it. Linux only.
"""

from __future__ import annotations

import atexit
import ctypes
import importlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from whereabouts.compiled_cache import is_compiled
from whereabouts.nodes.ros.footprint import keep_packed, settle

PR_SET_NAME, PR_SET_CHILD_SUBREAPER = 15, 36
READY_WITHIN = 60.0
"""s for imports and compiled functions; a host that takes longer is given up, and nodes start by themselves."""
LONGEST = 1 << 20
ADOPTED_WITHIN = 5.0
ACTIVE_VARIABLE = "WHEREABOUTS_ACTIVE_MARK"
"""Set to a file that a node makes once it is active: from then on its death is no failure to start."""
SUPERVISOR_VARIABLE = "WHEREABOUTS_SUPERVISOR"
"""Set by a supervisor to its process id: a node whose supervisor is gone has nobody left to end it, and ends itself."""


class Forked:
    """A process that the host made, with the part of `subprocess.Popen` that the supervisor needs."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self.returncode: int | None = None

    def poll(self) -> int | None:
        """Exit code, negative for a signal; None while it runs."""
        if self.returncode is None:
            try:
                pid, status = os.waitpid(self.pid, os.WNOHANG)
            except ChildProcessError:
                pid, status = self.pid, 1 << 8
            if pid:
                self.returncode = os.waitstatus_to_exitcode(status)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for its end. Raises subprocess.TimeoutExpired."""
        until = None if timeout is None else time.monotonic() + timeout
        while (code := self.poll()) is None:
            if until is not None and time.monotonic() >= until:
                raise subprocess.TimeoutExpired([], timeout or 0.0)
            time.sleep(0.005)
        return code

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            with suppress(ProcessLookupError):
                os.kill(self.pid, number)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)


class Host:
    """The supervisor's end: the host begins to load at once. Raises OSError where this machine cannot do it."""

    def __init__(self) -> None:
        if ctypes.CDLL(None, use_errno=True).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0) != 0:
            raise OSError(ctypes.get_errno(), "children of children cannot be adopted here")
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._socket = ours
        self._loaded = False
        ours.settimeout(READY_WITHIN)
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-m", __name__, str(theirs.fileno())],
                stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, pass_fds=[theirs.fileno()],
                start_new_session=True,
            )  # fmt: skip

    @classmethod
    def early(cls) -> Host | None:
        """One that loads while this process still reads what it has to start; None where this machine cannot do it."""
        try:
            host = cls()
        except OSError:
            return None
        # It would go on to load for somebody who has found nothing to start.
        atexit.register(host.end)
        return host

    def wait(self) -> None:
        """Until it has loaded. Raises OSError."""
        if not self._loaded and not self._socket.recv(64):
            raise ConnectionError("the host of the nodes has ended")
        self._loaded = True

    def start(self, command: list[str], log: Path, environment: Mapping[str, str]) -> Forked:
        """Fork a node. command : as for a process of its own, `python -m MODULE ...`. Raises OSError."""
        module, arguments = command[2], command[3:]
        request = {
            "module": module, "arguments": arguments, "log": str(log), "environment": dict(environment),
            "folder": os.getcwd(),
        }  # fmt: skip
        self.wait()
        self._socket.send(json.dumps(request).encode())
        answer = self._socket.recv(64)
        if not answer:
            raise ConnectionError("the host of the nodes has ended")
        return Forked(int(answer))

    @property
    def pid(self) -> int:
        return self._process.pid

    def end(self) -> None:
        """Nodes that run go on."""
        self._socket.close()
        self._process.kill()
        self._process.wait()


def serve(connection: socket.socket) -> None:
    """Load everything, then fork what is asked for until nobody asks any more."""
    _load()
    # What is here stays, and collecting must not touch it: pages that nobody writes to are shared.
    settle()
    # Who asks may be gone at any moment: nobody is left to tell.
    with suppress(ConnectionError):
        connection.send(b"loaded")
        while request := connection.recv(LONGEST):
            _fork(request, connection)


def _fork(request: bytes, connection: socket.socket) -> None:
    """Make the node that is asked for, and tell its process id."""
    ends = os.pipe()
    between = os.fork()
    if between == 0:
        node = os.fork()
        if node == 0:
            connection.close()
            _become(request)
        os.write(ends[1], str(node).encode())
        os._exit(0)
    os.close(ends[1])
    os.waitpid(between, 0)
    connection.send(os.read(ends[0], 64))
    os.close(ends[0])


def _load() -> None:
    from whereabouts.compile import PARTS
    from whereabouts.node_names import NODES

    keep_packed()
    for name in NODES:
        importlib.import_module(f"whereabouts.nodes.{name}_node")
    _load_messages()
    # Where not all is compiled yet, each node had better compile its own.
    if is_compiled(Path(__file__).parents[3]):
        for part in PARTS.values():
            part()


def _load_messages() -> None:
    """What a node loads when the first message of a kind is used, and the generators of messages that come along."""
    from rclpy.type_support import check_for_type_support

    interfaces = [module for name, module in sys.modules.items() if re.search(r"\.(msg|srv|action)$", name)]
    for kind in [kind for module in interfaces for kind in vars(module).values()]:
        if hasattr(type(kind), "__import_type_support__"):
            # One that cannot be loaded is the trouble of the node that needs it.
            with suppress(Exception):
                check_for_type_support(kind)


def _wait_for_parent(supervisor: int) -> None:
    """Until the process between has ended: a node whose parent is another takes its supervisor for gone."""
    until = time.monotonic() + ADOPTED_WITHIN
    while supervisor and os.getppid() != supervisor and time.monotonic() < until:
        time.sleep(0.001)


def _become(asked: bytes) -> None:
    """This process is the node from now on; never returns."""
    try:
        request: dict[str, Any] = json.loads(asked)
        _wait_for_parent(int(request["environment"].get(SUPERVISOR_VARIABLE, 0)))
        os.setsid()
        out = os.open(request["log"], os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
        os.dup2(out, 1)
        os.dup2(out, 2)
        os.close(out)
        os.chdir(request["folder"])
        os.environ.clear()
        os.environ.update(request["environment"])
        name = request["module"].rpartition(".")[2].removesuffix("_node")
        ctypes.CDLL(None).prctl(PR_SET_NAME, name.encode()[:15], 0, 0, 0)
        module = importlib.import_module(request["module"])
        sys.argv = [str(module.__file__), *request["arguments"]]
        module.main()
    except KeyboardInterrupt:
        # Before the node itself listens.
        os._exit(0)
    except BaseException:
        sys.excepthook(*sys.exc_info())
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(1)


if __name__ == "__main__":
    with socket.socket(fileno=int(sys.argv[1])) as given:
        serve(given)
