"""What looks at or acts on the running graph: console, questions, actions."""
