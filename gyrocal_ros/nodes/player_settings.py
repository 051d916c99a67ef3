"""Settings of the player node."""

from __future__ import annotations

from dataclasses import dataclass

from gyrocal_ros.config.declare import setting


@dataclass(frozen=True, slots=True)
class PlayerConfig:
    """Settings of the player."""

    bag: str = setting('', '', 'recording to play: a rosbag2 folder, one of its files, or a ROS 1 .bag')
    rate: float = setting(1.0, '', 'speed relative to the recording', low=0.01, high=1000.0)
    robot: str = setting('', '', 'namespace of the robot in the recording, if there are several')
    wait_for: str = setting('', '', 'nodes that have to subscribe before the start, separated by blanks')


@dataclass(frozen=True, slots=True)
class PlayerSections:
    """Settings that only the player has."""

    player: PlayerConfig = PlayerConfig()
