"""The live demo: a simulated robot that drives where the nodes send it."""
