"""Smoothing in a process of its own: gtsam keeps Python's lock for tens of milliseconds, in which no scan is taken in.

Orders go there at once and are done one after the other; only answers are waited for. The same orders give the same
answers as in one process, to the last digit.
"""

from __future__ import annotations

import os
import signal
import weakref
from collections.abc import Callable
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any

from estimation.checks import FloatArray
from loop_closure.graph.edges import Edge
from loop_closure.graph.smoother import News, Smoother

ENDED = "the process that smooths has ended"
FORGET = "forget"


class SmootherProcess:
    """A child of this process with any number of smoothers in it.

    It is forked, so that what is loaded is in memory once: make it before any thread is started. It ends with this
    process. Where it ends earlier, smoothers go on in this process: `SmoothedGraph` tells them all anew.

    prepare : called in it first of all.
    """

    def __init__(self, prepare: Callable[[], None] = lambda: None) -> None:
        self._pipe, theirs = Pipe()
        self.pid = os.fork()
        if self.pid == 0:
            self._pipe.close()
            try:
                prepare()
                _serve(theirs)
            finally:
                os._exit(0)
        theirs.close()
        self._made = 0

    @property
    def alive(self) -> bool:
        """Whether it takes orders."""
        return not self._pipe.closed

    def smoother(self, pose: FloatArray) -> RemoteSmoother | Smoother:
        """One more smoother, begun; in this process where this one has ended."""
        self._made += 1
        remote, local = RemoteSmoother(self, self._made), Smoother()
        try:
            remote.begin(pose)
        except RuntimeError:
            local.begin(pose)
            return local
        return remote

    def tell(self, smoother: int, order: str, *given: Any) -> None:
        """Have an order done. Raises RuntimeError where the process has ended."""
        try:
            self._pipe.send((smoother, order, given))
        except (OSError, ValueError) as error:
            self._end(error)

    def ask(self, smoother: int, order: str, *given: Any) -> Any:
        """Have an order done after those before it. Raises RuntimeError where one of them failed."""
        self.tell(smoother, order, *given)
        try:
            answer = self._pipe.recv()
        except (OSError, EOFError) as error:
            self._end(error)
        if isinstance(answer, Exception):
            raise answer
        return answer

    def end(self) -> None:
        """It ends when it has done its orders."""
        if self.alive:
            self._pipe.close()
            os.waitpid(self.pid, 0)

    def _end(self, error: Exception) -> None:
        self.end()
        raise RuntimeError(ENDED) from error


class RemoteSmoother:
    """A `Smoother` in a `SmootherProcess`; what fails there is raised by the next answer that is waited for."""

    def __init__(self, process: SmootherProcess, number: int) -> None:
        self._process, self._number = process, number
        weakref.finalize(self, _forget, process, number)

    def begin(self, pose: FloatArray) -> None:
        """See `Smoother`, as of the others."""
        self._process.tell(self._number, "begin", pose)

    def learn(self, news: News) -> None:
        self._process.tell(self._number, "learn", news)

    def smooth(self) -> None:
        self._process.tell(self._number, "smooth")

    def estimate(self) -> FloatArray:
        poses: FloatArray = self._process.ask(self._number, "estimate")
        return poses

    def settled(self, poses: FloatArray, edges: list[Edge]) -> FloatArray:
        settled: FloatArray = self._process.ask(self._number, "settled", poses, edges)
        return settled


def _forget(process: SmootherProcess, number: int) -> None:
    if process.alive:
        try:
            process.tell(number, FORGET)
        except RuntimeError:
            return


def _serve(pipe: Connection) -> None:
    """Do orders until nobody gives any more: the other end is closed, whatever becomes of the process there."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    smoothers: dict[int, Smoother] = {}
    failed: dict[int, RuntimeError] = {}
    while True:
        try:
            which, order, given = pipe.recv()
        except (EOFError, OSError):
            return
        if order == FORGET:
            smoothers.pop(which, None)
            failed.pop(which, None)
            continue
        if order in ("begin", "settled"):
            failed.pop(which, None)
        act: Callable[..., Any] = getattr(smoothers.setdefault(which, Smoother()), order)
        answer: Any = None
        if which not in failed:
            try:
                answer = act(*given)
            except RuntimeError as error:
                failed[which] = RuntimeError(str(error))
        if order in ("estimate", "settled"):
            pipe.send(failed.get(which, answer))
