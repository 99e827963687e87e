"""Parts of the node `world_model`: its camera, the frames of what was seen, what it publishes, and its services."""
