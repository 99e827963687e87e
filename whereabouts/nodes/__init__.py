"""All ROS glue: one module per node, message conversions, parameters, frames and diagnostics."""
