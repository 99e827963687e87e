"""What a node gives back once it is up."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numba import njit

from whereabouts.nodes.ros.footprint import settle


def resident() -> float:
    """MiB of the compiler's library in memory."""
    text = Path("/proc/self/smaps").read_text()
    blocks = re.findall(r"libllvmlite\S*\n(?:[^\n]*\n)*?Rss:\s+(\d+) kB", text)
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


def test_what_comes_from_the_cache_can_still_be_built_into_another_function(tmp_path: Path) -> None:
    module = tmp_path / "tripled.py"
    module.write_text(
        "from numba import njit\n\n@njit(cache=True)\ndef triple(value):\n    return 3 * value\n"
    )
    program = f"""
import sys
sys.path.insert(0, {str(tmp_path)!r})
from numba import njit
from tripled import triple
from whereabouts.nodes.ros.footprint import keep_packed

keep_packed()
keep_packed()
assert triple(2) == 6
packed = _packed(triple)

@njit
def plus_one(value):
    return triple(value) + 1

assert plus_one(2) == 7
print(sum(triple.stats.cache_hits.values()), packed, _packed(triple))
"""
    helper = """
def _packed(function):
    libraries = [overload.library for overload in function.overloads.values()]
    return any("_get_module_for_linking" in vars(library) for library in libraries)
"""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    command = [sys.executable, "-c", helper + program]
    for _ in range(2):
        run = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
    # The second time it came from the cache, was packed, and unpacked in order to be built in.
    assert run.stdout.split() == ["1", "True", "False"]
