"""The Poisson multi-Bernoulli mixture of extended targets: hypotheses, association, visibility."""
