"""A node's memory once it is up."""

from __future__ import annotations

import ctypes
import gc
import mmap

LIBRARY = "libllvmlite"
CODE = "r-xp"


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
    for start, length in _code_of(LIBRARY):
        advise(start, length, mmap.MADV_DONTNEED)


def _code_of(library: str) -> list[tuple[int, int]]:
    """Where a shared library's machine code is mapped: pages of the file that nobody has written to."""
    found = []
    try:
        with open("/proc/self/maps") as maps:
            for line in maps:
                span, mode, *_, path = line.split(maxsplit=5)
                if mode == CODE and library in path:
                    start, end = (int(text, 16) for text in span.split("-"))
                    found.append((start, end - start))
    except OSError:
        return []
    return found
