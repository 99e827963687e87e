"""Where one scan lies on another: refined from a guess, searched for without one, and whether to believe it."""
