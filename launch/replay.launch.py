"""A recording through the nodes, as if the robot were there; all ends with it."""

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
    'rate': ('1.0', 'how much faster than it was recorded'),
    'robot': ('', 'namespace of the robot in the recording, where that holds several'),
    'images': ('false', 'track the images even where the recording holds features'),
}
SIMULATED_TIME = {'use_sim_time': True}
PATIENT = {'images.patience_s': 0.1}
"""Images come without delay here, the IMU samples after them do not; and the same comes out every time."""


def nodes(arguments: Arguments) -> list:
    """The player, and who listens to it."""
    bag, with_images = Path(arguments['bag']).expanduser(), arguments['images'] == 'true'
    with open_storage(bag) as storage:
        options = TopicOptions(namespace=arguments['robot'] or None, use_images=with_images)
        tracks = Role.IMAGE in select_topics(storage.topics, options).topics
    listeners = [arguments.calibrator(follows_tracker=tracks, parameters=SIMULATED_TIME)]
    if tracks:
        listeners.append(arguments.node('tracker', {**SIMULATED_TIME, **PATIENT}))
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
    end = OnProcessExit(target_action=player, on_exit=[Shutdown(reason='the recording is at its end')])
    return [*listeners, RegisterEventHandler(end), player]


def generate_launch_description() -> LaunchDescription:
    """What `ros2 launch` asks for."""
    return describe(ARGUMENTS, nodes)
