"""What to look at and where to look: maintenance (chapter 3) and object search (chapter 5)."""
