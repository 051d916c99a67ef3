"""The player node: publishes a recording with its own stamps, and its time on /clock."""

from __future__ import annotations

import time
from contextlib import ExitStack
from pathlib import Path

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock as ClockMessage
from rosidl_runtime_py.utilities import get_message

from gyrocal_ros.bag.playback import Playback, PlayedTopic, PublishMode
from gyrocal_ros.bag.selection import select_topics
from gyrocal_ros.bag.source import topic_options
from gyrocal_ros.bag.storage import open_storage
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import NS_PER_S, nanoseconds, seconds
from gyrocal_ros.errors import ConfigError
from gyrocal_ros.msgs import to_ros
from gyrocal_ros.msgs.issues import raise_first_error
from gyrocal_ros.nodes.back_pressure import BackPressure
from gyrocal_ros.nodes.params import Settings
from gyrocal_ros.nodes.player_settings import PlayerSections
from gyrocal_ros.nodes.qos import SENSOR_OUT, STATIC

CLOCK_NS = NS_PER_S // 50
"""Period of /clock."""
REPEAT_NS = NS_PER_S
"""Period at which messages that were recorded once are repeated."""
HOLD_S, POLL_S, LOG_S = 0.005, 0.1, 5.0
"""Periods at which held messages are tried again, listeners are checked, and missing ones are logged."""
SETTLE_S = 1.0
"""Pause before the first message, for discovery, and after the last, so that it is processed."""
QOS = {PublishMode.STREAM: SENSOR_OUT, PublishMode.IMAGE: QoSProfile(depth=10), PublishMode.LATCHED: STATIC}


class PlayerNode:
    """The player; the node ends with the recording."""

    def __init__(self) -> None:
        self.node = node = rclpy.create_node('player')
        self._settings = Settings(node, PlayerSections(), ('player',)).config.player
        recording = Settings(node, Config(), ('recording',)).config.recording
        if not self._settings.bag:
            raise ConfigError('no recording is given', where='player.bag', todo='give -p player.bag:=PATH')
        path = Path(self._settings.bag).expanduser()
        self._files = ExitStack()
        storage = self._files.enter_context(open_storage(path))
        options = topic_options(recording, None, self._settings.robot or None, None)
        selection = select_topics(storage.topics, options)
        raise_first_error(selection.issues, str(path))
        playback = Playback(storage, selection)
        self._publishers: dict[str, Publisher] = {}
        for topic in playback.topics:
            self._add(topic)
        for topic, raw in playback.latched_messages():
            self._add(topic).publish(raw)
        self._pressure = BackPressure(node, self._publishers)
        self._clock = node.create_publisher(ClockMessage, '/clock', 10)
        self._make = to_ros.live_maker(get_message)
        self._messages = playback.messages()
        self._next = next(self._messages, None)
        self._repeated: dict[str, tuple[int, bytes]] = {}
        self._clock_ns = self._first_ns = self._next[0] if self._next else 0
        self._start_ns = 0
        self._logged_s = time.monotonic()
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(POLL_S, self._wait, clock=steady)

    def close(self) -> None:
        """Close the recording."""
        self._files.close()

    def _add(self, track: PlayedTopic) -> Publisher:
        if track.name not in self._publishers:
            kind, qos = get_message(track.type_name), QOS[track.mode]
            self._publishers[track.name] = self.node.create_publisher(kind, track.name, qos)
        return self._publishers[track.name]

    def _absent(self) -> set[str]:
        """Return the nodes to wait for that have not subscribed yet."""
        listeners = {
            listener.node_name
            for publisher in self._publishers.values()
            for listener in self.node.get_subscriptions_info_by_topic(publisher.topic_name)
        }
        return set(self._settings.wait_for.split()) - listeners

    def _wait(self) -> None:
        absent, now_s = self._absent(), time.monotonic()
        if absent and now_s - self._logged_s > LOG_S:
            self._logged_s = now_s
            self.node.get_logger().info(f'waiting for {", ".join(sorted(absent))}')
        if not absent:
            self.node.get_logger().info(f'playing {self._settings.bag}')
            self._start_ns = time.monotonic_ns() + nanoseconds(SETTLE_S)
            self._timer.callback = self._play
            self._wake_in(SETTLE_S)

    def _play(self) -> None:
        """Publish all messages that are due."""
        while self._next is not None and self.node.context.ok():
            recorded_ns, topic, raw = self._next
            due_s = seconds(recorded_ns - self._first_ns) / self._settings.rate
            ahead_s = due_s - seconds(time.monotonic_ns() - self._start_ns)
            if ahead_s > 0.0:
                return self._wake_in(ahead_s)
            if not self._pressure.may_send(topic.name):
                return self._wake_in(HOLD_S)
            if recorded_ns >= self._clock_ns:
                self._tick(recorded_ns)
            self._publishers[topic.name].publish(raw)
            self._pressure.add_sent(topic.name)
            if topic.repeats:
                self._repeated[topic.name] = recorded_ns, raw
            self._next = next(self._messages, None)
        self._timer.callback = self._end
        self._wake_in(SETTLE_S)

    def _tick(self, now_ns: int) -> None:
        """Publish the time, and repeat messages that were recorded once."""
        self._clock_ns = now_ns + CLOCK_NS
        self._clock.publish(self._make('rosgraph_msgs/msg/Clock', clock=self._make.time(now_ns)))
        for name, (sent_ns, raw) in self._repeated.items():
            if now_ns - sent_ns >= REPEAT_NS:
                self._publishers[name].publish(raw)
                self._repeated[name] = now_ns, raw

    def _end(self) -> None:
        if self._pressure.is_waiting:
            return self._wake_in(POLL_S)
        for publisher in self._publishers.values():
            publisher.wait_for_all_acked(Duration(seconds=SETTLE_S))
        self.node.get_logger().info('end of the recording')
        if losses := self._pressure.losses():
            self.node.get_logger().error(f'{losses} were lost: the computer is too slow; lower player.rate')
            raise SystemExit(1)
        self.node.context.try_shutdown()

    def _wake_in(self, wait_s: float) -> None:
        self._timer.timer_period_ns = nanoseconds(wait_s)
        self._timer.reset()


make = PlayerNode
