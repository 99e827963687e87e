"""Anchors and hypotheses: which detection is of which object, and where objects are (chapter 2)."""
