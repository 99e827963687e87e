"""What a place looks like, and whether two places are one: features, models, retrieval (Paper A, section 3)."""
