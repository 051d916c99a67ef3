"""Quality of service of the topics."""

from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

SENSOR_IN = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
"""QoS of incoming sensor data. It matches publishers of every reliability, and the queue is long enough for a
computer that is busy for some seconds."""
SENSOR_OUT = QoSProfile(depth=200, reliability=ReliabilityPolicy.RELIABLE)
"""QoS of outgoing sensor data: reliable for subscribers that request it."""
LATCHED = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)
"""QoS of a latched topic: a late subscriber gets the last message at once."""
STATIC = QoSProfile(
    depth=100, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)
"""QoS of /tf_static, which several nodes publish."""

NO_EVENTS_IN = SubscriptionEventCallbacks(use_default_callbacks=False)
NO_EVENTS_OUT = PublisherEventCallbacks(use_default_callbacks=False)
"""Event callbacks of topics with hundreds of messages a second: none, because the executor checks each event
every time it waits."""
