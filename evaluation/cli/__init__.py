"""Commands of `whereabouts` that need the experiments: the demo, experiments, training and judging."""
