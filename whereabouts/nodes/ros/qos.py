"""The quality of service that topics are published and heard with."""

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_profile_sensor_data


def reliable(depth: int, latched: bool) -> QoSProfile:
    """latched : what was sent last is kept for those who come late."""
    kept = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.RELIABLE, durability=kept)


def best_effort() -> QoSProfile:
    """Hears everybody, also those who publish reliably."""
    return QoSProfile(depth=LOOKED_AT, reliability=ReliabilityPolicy.BEST_EFFORT)


LATCHED = reliable(1, latched=True)
# A state that is kept for those who come late. Of two at once the first is heard as well: a replay counts them.
HEARD_LATCHED = reliable(10, latched=True)
TF_QOS = QoSProfile(depth=100)
TF_STATIC_QOS = reliable(100, latched=True)
# Messages that wait for a node.
BURST = 200
# Messages that wait for whoever only looks on.
LOOKED_AT = 50
# What is said once and must not get lost: a verdict, a change of who is there.
EVENTS = QoSProfile(depth=BURST)


def sensor_qos(reliability: str) -> QoSProfile:
    """The sensor-data profile, or a reliable one deep enough for a burst."""
    return QoSProfile(depth=BURST) if reliability == "reliable" else qos_profile_sensor_data
