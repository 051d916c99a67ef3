"""Plays a recording to the nodes of the robot; all nodes end with the recording."""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import RegisterEventHandler, Shutdown
from launch.event_handlers import OnProcessExit

from gyrocal_ros.bag.selection import TopicOptions, select_topics
from gyrocal_ros.bag.storage import open_storage
from gyrocal_ros.msgs.topics import Role
from gyrocal_ros.nodes.launching import Arguments, describe

ARGUMENTS = {
    'bag': (None, 'recording to play: a rosbag2 folder, one of its files, or a ROS 1 .bag'),
    'rate': ('1.0', 'speed relative to the recording'),
    'robot': ('', 'namespace of the robot in the recording, if there are several'),
    'images': ('false', 'track the images even if the recording has features'),
}
SIMULATED_TIME = {'use_sim_time': True}
PATIENCE = {'images.patience_s': 0.1}
"""Timeout of an image, longer than on the robot: images are played without their delay, hence before the
IMU samples that they wait for. It makes the result reproducible."""


def nodes(arguments: Arguments) -> list:
    """Return the player and the nodes that process the recording."""
    bag, with_images = Path(arguments['bag']).expanduser(), arguments['images'] == 'true'
    with open_storage(bag) as storage:
        options = TopicOptions(namespace=arguments['robot'] or None, use_images=with_images)
        tracks = Role.IMAGE in select_topics(storage.topics, options).topics
    listeners = [arguments.calibrator(follows_tracker=tracks, parameters=SIMULATED_TIME)]
    if tracks:
        listeners.append(arguments.node('tracker', {**SIMULATED_TIME, **PATIENCE}))
    player = arguments.node(
        'player',
        {
            'player.bag': str(bag),
            'player.rate': float(arguments['rate']),
            'player.robot': arguments['robot'],
            'player.wait_for': 'calibrator tracker' if tracks else 'calibrator',
            'recording.use_images': with_images,
        },
    )
    end = OnProcessExit(target_action=player, on_exit=[Shutdown(reason='end of the recording')])
    return [*listeners, RegisterEventHandler(end), player]


def generate_launch_description() -> LaunchDescription:
    """Return the launch description, for `ros2 launch`."""
    return describe(ARGUMENTS, nodes)
