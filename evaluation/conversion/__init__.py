"""Parts of the experiment `conversion`."""
