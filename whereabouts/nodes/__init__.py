"""All ROS glue: one module per node, message conversions, frames and diagnostics.

What goes in and out of each node is in `whereabouts.node_interfaces`.
"""
