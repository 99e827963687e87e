"""Words of the g2o text format."""

from __future__ import annotations

KEYWORDS = frozenset((b"VERTEX_SE2", b"EDGE_SE2"))
