"""The `whereabouts` command: one module per sub-command."""
