"""Runs nodes as processes: starts them, brings back those that die, ends them all cleanly.

Fast DDS gives every process a segment under /dev/shm and a lock that it holds for as long as it lives. A process that
is killed leaves both behind, eight megabytes each time: `remove_orphans` takes them away.
"""

from __future__ import annotations

import fcntl
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from estimation.errors import WhereaboutsError
from whereabouts.nodes.ros.host import ACTIVE_VARIABLE, SUPERVISOR_VARIABLE, Forked, Host
from whereabouts.system.resources import config_file

# A node that dies more often than LIMIT times within WINDOW, s, before it was ever active, or in a replay, is given up.
RESTART_LIMIT = 5
RESTART_WINDOW = 60.0
# s before it is started again: at once after the first death of late, then twice as long after each, up to the longest.
BACK_OFF, LONGEST_BACK_OFF = 0.5, 30.0
GRACE = 5.0


FOLDER = Path("/dev/shm")
LOCK = re.compile(r"(fastrtps_[0-9a-f]{16})_el")
# One that is younger may belong to a process that is about to take its lock.
YOUNG = 5.0


def remove_orphans(folder: Path = FOLDER) -> int:
    """Remove segments whose owners are gone; returns how many there were."""
    removed = 0
    try:
        locks = [path for path in folder.iterdir() if LOCK.fullmatch(path.name)]
    except OSError:
        return 0
    for lock in locks:
        try:
            removed += _remove_if_orphan(lock)
        except OSError:
            # Somebody else's, or gone meanwhile.
            continue
    return removed


def _remove_if_orphan(lock: Path) -> bool:
    if time.time() - lock.stat().st_mtime < YOUNG:
        return False
    with lock.open("rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        lock.with_name(lock.name.removesuffix("_el")).unlink(missing_ok=True)
        lock.unlink()
    return True


class SuiteError(WhereaboutsError):
    """A node could not be started or kept running; the message has the end of its log."""


@dataclass(frozen=True)
class NodeSpec:
    """One node to run.

    executable : such as "scan_registration". namespace : "" or "/robot1".
    parameters : set on top of the shipped file and `parameter_file`.
    remappings : topic names, from -> to.
    """

    executable: str
    namespace: str = ""
    parameters: Mapping[str, Any] = field(default_factory=dict)
    parameter_file: Path | None = None
    remappings: Mapping[str, str] = field(default_factory=dict)

    @property
    def full_name(self) -> str:
        return f"{self.namespace.rstrip('/')}/{self.executable}"

    def command(self) -> list[str]:
        command = [sys.executable, "-m", f"whereabouts.nodes.{self.executable}_node", "--ros-args"]
        if self.namespace:
            command += ["-r", f"__ns:={self.namespace}"]
        for source, target in self.remappings.items():
            command += ["-r", f"{source}:={target}"]
        files = [config_file(f"{self.executable}.yaml"), self.parameter_file]
        for path in filter(None, files):
            command += ["--params-file", str(path)]
        if os.environ.get("ROS_SECURITY_ENABLE") == "true":
            command += ["--enclave", self.full_name]
        for name, value in self.parameters.items():
            literal = json.dumps(value) if isinstance(value, bool | list) else value
            command += ["-p", f"{name}:={literal}"]
        return command


Process = subprocess.Popen[bytes] | Forked
Launch = Callable[[list[str], Path, Mapping[str, str]], Process]


def launch_alone(command: list[str], log: Path, environment: Mapping[str, str]) -> Process:
    """A process that imports everything for itself."""
    with log.open("ab") as out:
        # A session of its own, so that Ctrl-C reaches the supervisor only, which then ends the nodes in order.
        return subprocess.Popen(
            command, stdout=out, stderr=subprocess.STDOUT, env=environment, start_new_session=True
        )


class ManagedNode:
    """One node's process and its history."""

    def __init__(self, spec: NodeSpec, log: Path, environment: Mapping[str, str], launch: Launch) -> None:
        self.spec = spec
        self.log = log
        self._launch = launch
        self._mark = log.with_suffix(".active")
        self._mark.unlink(missing_ok=True)
        self._environment = {
            **environment, SUPERVISOR_VARIABLE: str(os.getpid()), ACTIVE_VARIABLE: str(self._mark)
        }  # fmt: skip
        self.starts: list[float] = []
        self.deaths: list[float] = []
        self.due: float | None = None
        self.process = self._start()

    def _start(self) -> Process:
        self.starts.append(time.monotonic())
        return self._launch(self.spec.command(), self.log, self._environment)

    @property
    def running(self) -> bool:
        return self.process.poll() is None

    @property
    def restarts(self) -> int:
        return len(self.starts) - 1

    @property
    def was_active(self) -> bool:
        """Whether it has ever been: its death is then no failure to start."""
        return self._mark.exists()

    def died(self) -> int:
        """Note a death, and when to start again; how many there have been of late."""
        now = time.monotonic()
        self.deaths.append(now)
        recent = sum(now - death < RESTART_WINDOW for death in self.deaths)
        wait = 0.0 if recent == 1 else min(BACK_OFF * 2.0 ** (recent - 2), LONGEST_BACK_OFF)
        self.due = now + wait
        return recent

    def restart(self) -> None:
        self.due = None
        self.process = self._start()

    def log_tail(self, lines: int = 15) -> str:
        return "\n".join(self.log.read_text(errors="replace").splitlines()[-lines:])


@dataclass
class Supervisor:
    """Keeps a set of nodes running; a context manager that ends them when left.

    log_directory : one log file per node goes there.
    restart : bring back a node that died of a signal or an error, after ever longer waits.
    patient : go on for ever with a node that was active once; otherwise it is given up after RESTART_LIMIT deaths.
    on_event : called with a sentence whenever a node died, came back or was given up.
    hosted : fork nodes from one process that has loaded everything (`Host`), where this machine can: for several nodes.
    host : that process, where it was begun already; it ends with the supervisor.
    on_death : called with the full name of a node that has ended, before it is started again.
    """

    log_directory: Path
    restart: bool = True
    on_event: Callable[[str], None] = lambda text: None
    patient: bool = False
    hosted: bool = False
    host: Host | None = None
    on_death: Callable[[str], None] = lambda name: None
    nodes: dict[str, ManagedNode] = field(default_factory=dict, init=False)
    _given_up: set[str] = field(default_factory=set, init=False)
    # Of processes, that nodes which have ended led.
    _groups: set[int] = field(default_factory=set, init=False)

    def __enter__(self) -> Supervisor:
        remove_orphans()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self, spec: NodeSpec) -> ManagedNode:
        self.log_directory.mkdir(parents=True, exist_ok=True)
        log = self.log_directory / f"{spec.full_name.strip('/').replace('/', '.')}.log"
        log.unlink(missing_ok=True)
        if self.hosted:
            try:
                # It takes seconds, in which Ctrl-C has nothing to end yet.
                self.host = self.host or Host()
                self.host.wait()
            except OSError as error:
                self._go_on_without_host(error)
        # An interrupt between the process and its entry here would leave a node that nobody ends.
        with _interrupt_later():
            self.nodes[spec.full_name] = ManagedNode(spec, log, os.environ, self._launch)
        return self.nodes[spec.full_name]

    def _launch(self, command: list[str], log: Path, environment: Mapping[str, str]) -> Process:
        if self.host is not None:
            try:
                return self.host.start(command, log, environment)
            except OSError as error:
                self._go_on_without_host(error)
        return launch_alone(command, log, environment)

    def _go_on_without_host(self, error: OSError) -> None:
        self.hosted = False
        self._end_host()
        self.on_event(
            f"nodes are loaded one by one: what they share is not there: {error or type(error).__name__}"
        )

    @property
    def host_pid(self) -> int | None:
        """Process from which nodes are forked, if there is one."""
        return None if self.host is None else self.host.pid

    def _end_host(self) -> None:
        if self.host is not None:
            self.host.end()
            self.host = None

    def _has_ended(self) -> bool:
        """Whether any child has: one question instead of one for each, as it is asked between any two messages."""
        if any(node.process.returncode is not None for node in self.nodes.values()):
            return True
        try:
            return os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None
        except ChildProcessError:
            return True

    def check(self) -> None:
        """Look after the nodes; call it now and then.

        Raises SuiteError: a node ended by itself before it was ever active, or keeps dying and there is no patience.
        """
        if not self._has_ended():
            return
        self._reap_orphans()
        for name, node in self.nodes.items():
            if node.running or name in self._given_up:
                continue
            if node.due is None:
                self._bury(name, node)
            if node.due is not None and time.monotonic() >= node.due:
                code = node.process.returncode or 0
                node.restart()
                self.on_event(f"{name} ended with {_reason(code)} and was started again")

    def _bury(self, name: str, node: ManagedNode) -> None:
        """A node has ended: decide when it is started again, if at all."""
        code, known = node.process.returncode, node.was_active
        self._groups.add(node.process.pid)
        if code in (1, 2) and not known:
            self._given_up.add(name)
            raise SuiteError(f"{name} could not start; its last lines:\n{node.log_tail()}")
        if not self.restart:
            return
        self.on_death(name)
        remove_orphans()
        if node.died() > RESTART_LIMIT and not (known and self.patient):
            self._given_up.add(name)
            raise SuiteError(f"{name} died {len(node.deaths)} times; its last lines:\n{node.log_tail()}")

    def _reap_orphans(self) -> None:
        """Forget processes that a node had made for itself: once it has ended they are children of this one, if hosted.

        Ended ones of others, such as of a browser that was started beside, are none of its business.
        """
        for group in tuple(self._groups):
            try:
                while os.waitpid(-group, os.WNOHANG)[0]:
                    pass
            except ChildProcessError:
                self._groups.remove(group)

    def stop(self) -> None:
        """End all nodes: SIGINT, and for one that does not listen SIGKILL."""
        for node in self.nodes.values():
            if node.running:
                node.process.send_signal(signal.SIGINT)
        deadline = time.monotonic() + GRACE
        for name, node in self.nodes.items():
            try:
                node.process.wait(max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                self.on_event(f"{name} did not end in {GRACE:.0f} s and was killed")
                node.process.kill()
                node.process.wait()
        self._end_host()
        remove_orphans()


@contextmanager
def _interrupt_later() -> Iterator[None]:
    """Hold back Ctrl-C until the block is done."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    held: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, frame: held.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if held:
        raise KeyboardInterrupt


def _reason(code: int) -> str:
    return signal.Signals(-code).name if code < 0 else f"exit code {code}"
