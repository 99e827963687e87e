"""The quality of service that topics are published and heard with."""

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_profile_sensor_data


def latched(depth: int = 1) -> QoSProfile:
    """Reliable; what was sent last is kept for those who come late."""
    return QoSProfile(depth=depth, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def best_effort(depth: int) -> QoSProfile:
    """Hears everybody, also those who publish reliably."""
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT)


LATCHED = latched()
# A state that is kept for those who come late. Of two at once the first is heard as well: a replay counts them.
HEARD_LATCHED = latched(10)
TF_QOS = QoSProfile(depth=100)
TF_STATIC_QOS = latched(100)
BURST = 200
# What is said once and must not get lost: a verdict, a change of who is there.
EVENTS = QoSProfile(depth=BURST)


def sensor_qos(reliability: str) -> QoSProfile:
    """The sensor-data profile, or a reliable one deep enough for a burst."""
    return QoSProfile(depth=BURST) if reliability == "reliable" else qos_profile_sensor_data
