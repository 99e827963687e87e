"""Parts of the experiment `loops`: how place models are learned and judged (Paper A, section 5)."""
