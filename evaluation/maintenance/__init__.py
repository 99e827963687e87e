"""Parts of the experiment `maintenance`."""
