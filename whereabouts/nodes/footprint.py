"""A node's memory once it is up."""

from __future__ import annotations

import ctypes
import gc
import mmap

LIBRARY = "libllvmlite"


def settle() -> None:
    """What start-up needed and running does not: garbage is collected once, LLVM's code leaves memory.

    What was imported stays for good, so that the collector need not look at it again while scans arrive. Compiled
    functions are loaded by now; should another be compiled later, the kernel reads the code from the file again.
    """
    gc.collect()
    gc.freeze()
    libc = ctypes.CDLL(None, use_errno=True)
    advise = getattr(libc, "madvise", None)
    if advise is None:
        return
    advise.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
    for start, length in _untouched_parts_of(LIBRARY):
        advise(start, length, mmap.MADV_DONTNEED)


def release() -> None:
    """Before the process ends: collect also what `settle` has set aside."""
    gc.unfreeze()
    gc.collect()


def _untouched_parts_of(library: str) -> list[tuple[int, int]]:
    """Start and length of each mapping of a shared library that still is what the file holds."""
    found = []
    try:
        with open("/proc/self/smaps") as maps:
            for line in maps:
                name, *values = line.split()
                if not name.endswith(":"):
                    start, end = (int(text, 16) for text in name.split("-"))
                    ours = library in line and "w" not in values[0]
                elif name == "Anonymous:" and ours and values[0] == "0":
                    found.append((start, end - start))
    except OSError:
        return []
    return found
