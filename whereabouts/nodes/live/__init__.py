"""What looks at or acts on the running graph: console, demo, questions."""
