"""Keyframes, candidates for closures, and SLAM over them."""
