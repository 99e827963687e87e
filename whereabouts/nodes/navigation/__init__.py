"""Who may have the base, and how it is driven: nav2's actions, maps and masks."""
