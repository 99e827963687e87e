"""Parts of the experiment `slam`."""
