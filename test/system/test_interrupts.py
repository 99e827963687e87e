"""Ctrl-C ends a program in an orderly way wherever it comes."""

from __future__ import annotations

import pytest

from whereabouts.interrupts import interrupts_kept
from whereabouts.nodes.executor import NodeExecutor


def interrupted_in_compiled_code() -> None:
    """What pybind11 makes of an interrupt that comes while one of its functions runs."""
    raise SystemError("returned a result with an exception set") from KeyboardInterrupt()


def test_an_interrupt_in_compiled_code_stays_an_interrupt() -> None:
    with pytest.raises(KeyboardInterrupt), interrupts_kept():
        interrupted_in_compiled_code()


def test_another_error_of_compiled_code_stays_what_it_is() -> None:
    with pytest.raises(SystemError, match="broken"), interrupts_kept():
        raise SystemError("broken")


def test_a_node_does_not_take_an_interrupt_for_a_defect() -> None:
    class Node:
        defects: list[Exception] = []

        def report_defect(self, where: str, error: Exception) -> None:
            self.defects.append(error)

    node = Node()
    executor = NodeExecutor.__new__(NodeExecutor)
    with pytest.raises(KeyboardInterrupt):
        try:
            interrupted_in_compiled_code()
        except SystemError as error:
            executor._survive(node, node, error)
    assert not node.defects
    executor._survive(node, node, SystemError("broken"))
    assert len(node.defects) == 1
