"""Maps on disk: saved, checked, merged, and a robot found in them."""
