"""Parts of the experiment `loops`."""
