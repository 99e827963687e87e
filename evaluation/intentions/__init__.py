"""Parts of the experiment `intentions`."""
