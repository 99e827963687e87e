"""The chaos laboratory: what arrives at nodes and readers is generated, mutated and damaged until something breaks."""
