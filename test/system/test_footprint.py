"""What a node gives back once it is up."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest
from numba import njit

from whereabouts.nodes.footprint import LIBRARY, settle


def resident() -> float:
    """MiB of the compiler's library in memory."""
    text = Path("/proc/self/smaps").read_text()
    blocks = re.findall(rf"{LIBRARY}\S*\n(?:[^\n]*\n)*?Rss:\s+(\d+) kB", text)
    return sum(map(int, blocks)) / 1024.0


@pytest.mark.skipif(sys.platform != "linux", reason="reads the Linux kernel's account of memory")
def test_the_compiler_leaves_memory_and_comes_back_when_it_is_needed() -> None:
    @njit  # type: ignore[untyped-decorator]
    def double(value):  # type: ignore[no-untyped-def]
        return 2 * value

    assert double(2) == 4
    before = resident()
    settle()
    assert resident() < 0.5 * before
    assert double(2.5) == 5.0
    np.testing.assert_array_equal(double(np.arange(3.0)), [0.0, 2.0, 4.0])
