"""The robot or the user of a demo, in the graph with the nodes; and the live demo, a day that the nodes drive."""
