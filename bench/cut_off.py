"""Ends tests after so much processor time: compiled functions run as plain Python, for `make coverage`, take for ever.

pytest-timeout goes by the wall clock, so that a busy machine would reach less, and its exception may arise in a line
without a number, which pytest cannot report.
"""

from __future__ import annotations

import signal
from collections.abc import Generator
from types import FrameType

import pytest

LIMIT = 10.0  # s of processor time for each test
AGAIN = 0.01  # s until the next try


def _cut_off(_signal: int, frame: FrameType | None) -> None:
    signal.setitimer(signal.ITIMER_VIRTUAL, AGAIN)  # whoever catches the exception is cut off once more
    if frame is not None and frame.f_lineno is not None:
        pytest.fail(f"cut off after {LIMIT:g} s of processor time")


def _limited() -> Generator[None, object, object]:
    signal.signal(signal.SIGVTALRM, _cut_off)
    signal.setitimer(signal.ITIMER_VIRTUAL, LIMIT)
    try:
        return (yield)
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)


pytest_runtest_setup = pytest.hookimpl(wrapper=True)(_limited)
pytest_runtest_call = pytest.hookimpl(wrapper=True)(_limited)
