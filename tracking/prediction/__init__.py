"""Maps of where people go, and social forces between them (chapter 4)."""
