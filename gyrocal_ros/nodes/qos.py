"""Quality of service of the topics."""

from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

SENSOR_IN = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Sensor data as they come in: with publishers of every reliability. A computer that is busy for some
seconds loses nothing."""
SENSOR_OUT = QoSProfile(depth=200, reliability=ReliabilityPolicy.RELIABLE)
"""Sensor data that go out: nothing is lost towards those who ask for all."""
LATCHED = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)
"""The last one is sent at once to whoever subscribes late."""
STATIC = QoSProfile(
    depth=100, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)
"""As /tf_static is published, by several."""

QUIET_IN = SubscriptionEventCallbacks(use_default_callbacks=False)
QUIET_OUT = PublisherEventCallbacks(use_default_callbacks=False)
"""For topics that come hundreds of times a second: each event that is waited for costs, every time."""
