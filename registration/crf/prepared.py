"""Scans made ready once in their life: each is registered to several others, whole and in parts."""

from __future__ import annotations

from weakref import WeakKeyDictionary

from registration.prepared import PreparedScan, prepare_scan
from registration.scan import Scan

_made: WeakKeyDictionary[Scan, PreparedScan] = WeakKeyDictionary()


def prepared(scan: Scan) -> PreparedScan:
    """`PreparedScan` of a scan; not to be written to."""
    made = _made.get(scan)
    if made is None:
        made = _made[scan] = prepare_scan(scan)
    return made
