"""Ctrl-C ends a program in an orderly way wherever it comes."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from whereabouts.nodes.ros import base
from whereabouts.nodes.ros.executor import NodeExecutor
from whereabouts.system.interrupts import interrupts_kept


def interrupted() -> SystemError:
    """What pybind11 makes of an interrupt that comes while one of its functions runs."""
    error = SystemError("returned a result with an exception set")
    error.__cause__ = KeyboardInterrupt()
    return error


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
