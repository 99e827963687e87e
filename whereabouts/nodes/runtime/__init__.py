"""Nodes as processes: started, watched, replayed into, recorded."""
