"""Parts of the experiment `phd`."""
