"""Outlines of scans, each made once in its life: a scan is registered to several others, whole and in parts."""

from __future__ import annotations

from weakref import WeakKeyDictionary

from registration.outline import Outline, outline_of
from registration.scan import Scan

_made: WeakKeyDictionary[Scan, Outline] = WeakKeyDictionary()


def outline_of_scan(scan: Scan) -> Outline:
    """`Outline` of a scan; not to be written to."""
    outline = _made.get(scan)
    if outline is None:
        outline = _made[scan] = outline_of("scan", scan)
    return outline
