"""A robot without a robot: emulated board and ceiling camera, and all nodes as they run on a real one."""

import tempfile
import time
from pathlib import Path

from launch import LaunchDescription
from launch.actions import RegisterEventHandler, Shutdown
from launch.event_handlers import OnProcessExit
from launch_ros.actions import Node

from gyrocal_ros.nodes.launching import PACKAGE, Arguments, describe

ARGUMENTS = {
    'scenario': ('cleaning', 'what the robot does, as in gyrocal simulate'),
    'seed': ('0', 'of all randomness'),
    'duration': ('300', 'how long it drives, in seconds'),
    'jitter': ('0.0', 'frames of the board come up to so many seconds later'),
    'faults': ('', 'of the board: KIND@FROM+FOR[=SHARE], see board_emulator --help; separated by blanks'),
    'troubles': ('', 'of the camera: cover@, off@ or clock@FROM+FOR; separated by blanks'),
    'respawn': ('true', 'start driver, tracker and calibrator again when they end by themselves'),
}
READY_S = 12.0
"""So long the slowest of them needs to be ready for the start, on a small computer."""


def nodes(arguments: Arguments) -> list:
    """The robot and who works on it."""
    start_at = time.time() + READY_S
    port = Path(tempfile.mkdtemp(prefix='gyrocal_')) / 'board'
    given = {name: arguments[name] for name in ('scenario', 'seed', 'duration', 'jitter')}
    options = [word for name, value in given.items() for word in (f'--{name}', value)]
    faults = [word for fault in arguments['faults'].split() for word in ('--fault', fault)]
    board = Node(
        package=PACKAGE,
        executable='board_emulator',
        arguments=['--link', str(port), '--start-at', f'{start_at:.6f}', *options, *faults],
        output='screen',
    )
    camera = arguments.node(
        'ceiling_emulator',
        {
            'ceiling.scenario': given['scenario'],
            'ceiling.seed': int(given['seed']),
            'ceiling.duration_s': float(given['duration']),
            'ceiling.start_at': start_at,
            'ceiling.troubles': arguments['troubles'],
        },
    )
    again = {'respawn': arguments['respawn'] == 'true', 'respawn_delay': 1.0}
    return [
        RegisterEventHandler(
            OnProcessExit(target_action=board, on_exit=[Shutdown(reason='the drive is over')])
        ),
        board,
        camera,
        arguments.node('driver', {'driver.port': str(port), 'driver.publish_odom_transform': True}, **again),
        arguments.node('tracker', **again),
        arguments.calibrator(follows_tracker=True, parameters={}, **again),
    ]


def generate_launch_description() -> LaunchDescription:
    """What `ros2 launch` asks for."""
    return describe(ARGUMENTS, nodes)
