"""Finds publishers and subscriptions of other nodes that can never be connected, because of their QoS.

The events of rclpy would tell so, too, but the executor then checks each of them whenever it waits.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

from rclpy.node import Node
from rclpy.qos import QoSCompatibility, qos_check_compatible

OWN_TOPICS = ('/parameter_events', '/rosout')
"""Topics that every node has."""


def incompatible_endpoints(node: Node) -> Iterator[str]:
    """Yield a text for each endpoint of another node with which no message of a node can be exchanged."""
    own = {endpoint.topic_name for endpoint in (*node.subscriptions, *node.publishers)}
    me = node.get_name(), node.get_namespace()
    for topic in sorted(own.difference(OWN_TOPICS)):
        publishers = node.get_publishers_info_by_topic(topic)
        subscribers = node.get_subscriptions_info_by_topic(topic)
        for offered, wanted in product(publishers, subscribers):
            ends = [(end.node_name, end.node_namespace) for end in (offered, wanted)]
            result, why = qos_check_compatible(offered.qos_profile, wanted.qos_profile)
            if me in ends and result == QoSCompatibility.ERROR:
                who = f'the subscriber {ends[1][0]}' if ends[0] == me else f'the publisher {ends[0][0]}'
                reason = why.removeprefix('ERROR: ').rstrip(';. ')
                yield (
                    f'{topic}: {who} has an incompatible QoS ({reason}): no message arrives; change the QoS '
                    'of that node'
                )
