"""Parts of the experiment `anchoring`."""
