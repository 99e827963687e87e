"""A node's memory once it is up."""

from __future__ import annotations

import ctypes
import gc
import mmap
import sys
import weakref
from typing import Any

LIBRARY = "libllvmlite"


def settle() -> None:
    """What start-up needed and running does not: garbage is collected once, LLVM and what it works on leave memory.

    What was imported stays for good, so that the collector need not look at it again while scans arrive. Compiled
    functions are loaded by now; should another be compiled later, the kernel reads LLVM's code from the file again.
    """
    gc.collect()
    _pack_intermediate_code()
    gc.freeze()
    libc = ctypes.CDLL(None, use_errno=True)
    if hasattr(libc, "malloc_trim"):
        libc.malloc_trim(0)
    advise = getattr(libc, "madvise", None)
    if advise is None:
        return
    advise.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
    for start, length in _untouched_parts_of(LIBRARY):
        advise(start, length, mmap.MADV_DONTNEED)


def _pack_intermediate_code() -> None:
    """Compiled functions bring along what it takes to build them into others: a tenth of it as bytes, until asked for.

    For numba as it is now; where it is otherwise, that code stays as it is.
    """
    codegen = sys.modules.get("numba.core.codegen")
    kind = getattr(codegen, "CPUCodeLibrary", None)
    if kind is None or not hasattr(kind, "_get_module_for_linking"):
        return
    kinds = {kind, *kind.__subclasses__()}
    for library in [item for item in gc.get_objects() if type(item) in kinds]:
        module = getattr(library, "_shared_module", None)
        if module is not None:
            library._get_module_for_linking = _Unpacking(library, module.as_bitcode())
            library._shared_module = None


class _Unpacking:
    """Stands in for a library's own method until that is called for the first time."""

    def __init__(self, library: Any, packed: bytes) -> None:
        self._library = weakref.ref(library)
        self._packed = packed

    def __call__(self) -> Any:
        from llvmlite.binding import parse_bitcode

        library = self._library()
        assert library is not None
        del library._get_module_for_linking
        library._shared_module = parse_bitcode(self._packed)
        return library._shared_module


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
