"""Ctrl-C ends a program in an orderly way wherever it comes."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest

from whereabouts.nodes.ros import base
from whereabouts.nodes.ros.executor import NodeExecutor
from whereabouts.system.interrupts import interrupts_kept, listen_to_interrupts

ROOT = Path(__file__).resolve().parents[2]


def interrupted() -> SystemError:
    """What pybind11 makes of an interrupt that comes while one of its functions runs."""
    error = SystemError("returned a result with an exception set")
    error.__cause__ = KeyboardInterrupt()
    return error


MANY = """
import os, signal, threading, time
from typing import NamedTuple
import numba, numpy as np
from whereabouts.system.interrupts import listen_to_interrupts

class Pair(NamedTuple):
    a: np.ndarray
    b: np.ndarray

@numba.njit
def doubled(pair):
    return Pair(pair.a * 2.0, pair.b)

pair = doubled(Pair(np.ones(3), np.ones(3)))
listen_to_interrupts()
at_work = threading.Event()

def interrupt():
    for _ in range(30):
        at_work.wait()
        at_work.clear()
        time.sleep(0.001)
        os.kill(os.getpid(), signal.SIGINT)

threading.Thread(target=interrupt).start()
for _ in range(30):
    try:
        at_work.set()
        while True:
            doubled(pair)
    except KeyboardInterrupt:
        pass
print("whole")
"""


def test_an_interrupt_does_not_break_compiled_code() -> None:
    ended = subprocess.run([sys.executable, "-c", MANY], capture_output=True, text=True, cwd=ROOT)
    assert (ended.returncode, ended.stdout) == (0, "whole\n"), ended.stderr


@pytest.mark.parametrize("module", ["namedtuple_Pair", "sensor_msgs.msg._laser_scan", "numba.core.serialize"])
def test_an_interrupt_waits_until_what_compiled_code_calls_is_over(module: str) -> None:
    before = signal.getsignal(signal.SIGINT)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    listen_to_interrupts()
    names = {"__name__": module, "signal": signal}
    exec("def make():\n    signal.raise_signal(signal.SIGINT)\n    return 'made'", names)
    try:
        assert names["make"]() == "made"  # type: ignore[operator]
        with pytest.raises(KeyboardInterrupt):
            threading.Event().wait()
    finally:
        signal.signal(signal.SIGINT, before)


def test_an_interrupt_in_compiled_code_stays_an_interrupt() -> None:
    with pytest.raises(KeyboardInterrupt), interrupts_kept():
        raise interrupted()


def test_another_error_of_compiled_code_stays_what_it_is() -> None:
    with pytest.raises(SystemError, match="broken"), interrupts_kept():
        raise SystemError("broken")


def test_a_node_does_not_take_an_interrupt_for_a_defect() -> None:
    defects: list[Exception] = []
    node = SimpleNamespace(report_defect=lambda where, error: defects.append(error))
    survive = NodeExecutor._survive.__get__(SimpleNamespace())  # it asks nothing of its executor
    with pytest.raises(KeyboardInterrupt):
        survive(node, node, interrupted())
    assert not defects
    survive(node, node, SystemError("broken"))
    assert len(defects) == 1


@pytest.mark.parametrize("running", [False, True])
def test_who_is_told_to_stop_by_two_at_once_ends_in_order(
    running: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def shut_already() -> None:
        raise RuntimeError("rcl_shutdown already called")

    monkeypatch.setattr(base, "rclpy", SimpleNamespace(try_shutdown=shut_already, ok=lambda: running))
    if running:
        with pytest.raises(RuntimeError):
            base._shut_down()
    else:
        base._shut_down()
