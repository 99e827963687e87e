"""How place models are learned and judged (Paper A, section 5)."""
