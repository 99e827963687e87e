"""The demo: a recorded apartment through all nodes, judged by its ground truth, and told as a page with pictures."""
