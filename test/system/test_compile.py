"""What set-up compiles is all that nodes need when they start."""

from __future__ import annotations

import subprocess
import sys

from whereabouts import compile as compiling

STARTS = """
import gc
from numba.core.dispatcher import Dispatcher
from whereabouts.compile import PARTS

for part in PARTS.values():
    part()
found = [item for item in gc.get_objects() if isinstance(item, Dispatcher) and item.overloads]
print(len(found), sorted(item.__name__ for item in found if sum(item.stats.cache_misses.values())))
"""


def test_a_second_start_compiles_nothing() -> None:
    assert compiling.main() == 0
    run = subprocess.run([sys.executable, "-c", STARTS], capture_output=True, text=True, check=True)
    count, missed = run.stdout.split(maxsplit=1)
    assert int(count) > 50
    assert missed.strip() == "[]"
