"""The nodes of the suite, in the order in which they are brought up: who is listened to comes first."""

NODES = (
    "scan_registration", "loop_closure", "target_tracker", "motion_predictor", "world_model", "verifier",
    "world_maintenance", "object_search",
)  # fmt: skip
