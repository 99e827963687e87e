"""What every node is built on: the base class, inputs, outputs, parameters, time, turns and diagnostics."""
