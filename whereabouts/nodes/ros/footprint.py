"""A node's memory once it is up."""

from __future__ import annotations

import ctypes
import gc
import mmap
import os
import weakref
from pathlib import Path
from typing import Any

from whereabouts.system.resources import config_file

PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"


def settle() -> None:
    """What start-up needed and running does not: garbage is collected once, and the code of libraries leaves memory.

    What was imported stays for good, so that the collector need not look at it again while scans arrive. Most of the
    code, that of LLVM for one, was needed to load; what is needed again the kernel reads from the files again.
    """
    gc.collect()
    gc.freeze()
    libc = ctypes.CDLL(None, use_errno=True)
    if hasattr(libc, "malloc_trim"):
        libc.malloc_trim(0)
    advise = getattr(libc, "madvise", None)
    if advise is None:
        return
    advise.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
    for start, length in _untouched_libraries():
        advise(start, length, mmap.MADV_DONTNEED)


def use_small_segment() -> None:
    """Of a process that sends no large messages, before it makes a node: Fast DDS has all of its shared memory at once.

    Where the profile in use is not ours, it stays.
    """
    profile = Path(os.environ.get(PROFILES, ""))
    if profile.name == "fastdds.xml" and profile.resolve() == config_file("fastdds.xml").resolve():
        os.environ[PROFILES] = str(config_file("fastdds_small.xml"))


def keep_packed() -> None:
    """From now on, compiled functions that come from the cache bring along what builds them into others as bytes only.

    Parsed it is ten times as large, and start-up needs none of it. Reaches into numba as it is now; where numba is
    otherwise, everything stays as it is.
    """
    from numba.core import codegen

    kind: Any = codegen.CPUCodeLibrary
    load = getattr(getattr(kind, "_unserialize", None), "__func__", None)
    if load is None or not hasattr(kind, "_get_module_for_linking") or load.__module__ == __name__:
        return

    def load_packed(cls: Any, generator: Any, state: Any) -> Any:
        library = load(cls, generator, state)
        _pack(library, state)
        return library

    kind._unserialize = classmethod(load_packed)


def _pack(library: Any, state: Any) -> None:
    """What `_unserialize` parsed of the second of `state`'s data is forgotten again."""
    if getattr(library, "_shared_module", None) is None or len(state) != 3 or state[1] != "object":
        return
    library._get_module_for_linking = _Unpacking(library, state[2][1])
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


def _untouched_libraries() -> list[tuple[int, int]]:
    """Start and length of each mapping of a shared library that still is what the file holds."""
    found = []
    try:
        with open("/proc/self/smaps") as maps:
            for line in maps:
                name, *values = line.split()
                if not name.endswith(":"):
                    start, end = (int(text, 16) for text in name.split("-"))
                    ours = ".so" in line and "w" not in values[0]
                elif name == "Anonymous:" and ours and values[0] == "0":
                    found.append((start, end - start))
    except OSError:
        return []
    return found
