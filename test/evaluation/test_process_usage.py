"""What processes cost, with those that they made for themselves."""

import subprocess
import sys

import pytest

from evaluation.process_usage import family, memory, processor_seconds

BUSY = "sum(range(10**7)); data = bytearray(b'x' * (32 << 20)); print('ready', flush=True); input()"


def test_a_child_counts_with_its_parent() -> None:
    script = (
        f"import subprocess, sys; child = subprocess.Popen([sys.executable, '-c', {BUSY!r}], stdin=subprocess.PIPE);"
        "input(); child.communicate(b'\\n'); print('over', flush=True); input()"
    )
    parent = subprocess.Popen(
        [sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert parent.stdin is not None
    assert parent.stdout is not None
    assert parent.stdout.readline() == "ready\n"
    with_child, seconds, both = memory(parent.pid), processor_seconds(parent.pid), family(parent.pid)
    parent.stdin.write("\n")
    parent.stdin.flush()
    assert parent.stdout.readline() == "over\n"
    alone = memory(parent.pid)
    assert len(both) == 2
    assert family(parent.pid) == [parent.pid]
    assert with_child[0] > alone[0] + 32.0
    assert with_child[1] > alone[1] + 32.0
    assert seconds > processor_seconds(parent.pid)
    parent.communicate("\n")
    with pytest.raises(FileNotFoundError):
        memory(parent.pid)
