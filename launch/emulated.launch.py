"""An emulated robot: board and ceiling camera are emulated, all nodes run as on a real robot."""

import tempfile
import time
from pathlib import Path

from launch import LaunchDescription
from launch.actions import RegisterEventHandler, Shutdown
from launch.event_handlers import OnProcessExit
from launch_ros.actions import Node

from gyrocal_ros.nodes.launching import PACKAGE, Arguments, describe

ARGUMENTS = {
    'scenario': ('cleaning', 'scenario of the drive, as in gyrocal simulate'),
    'seed': ('0', 'seed of all random numbers'),
    'duration': ('300', 'duration of the drive, in seconds'),
    'jitter': ('0.0', 'maximum additional delay of the frames of the board, in seconds'),
    'faults': (
        '',
        'faults of the board: KIND@FROM+FOR[=SHARE], see board_emulator --help; separated by blanks',
    ),
    'troubles': (
        '',
        'faults of the camera: cover@, off@, clock@, freeze@ or lose@FROM+FOR; separated by blanks',
    ),
    'respawn': ('true', 'restart driver, tracker and calibrator when they end by themselves'),
}
READY_S = 12.0
"""Time from the launch to the start of the drive, by which all nodes are ready, also on a small computer."""


def nodes(arguments: Arguments) -> list:
    """Return the emulators and the nodes of the robot."""
    start_at = time.time() + READY_S
    port = Path(tempfile.mkdtemp(prefix='gyrocal_')) / 'board'
    common = {name: arguments[name] for name in ('scenario', 'seed', 'duration', 'jitter')}
    options = [word for name, value in common.items() for word in (f'--{name}', value)]
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
            'ceiling.scenario': common['scenario'],
            'ceiling.seed': int(common['seed']),
            'ceiling.duration_s': float(common['duration']),
            'ceiling.start_at': start_at,
            'ceiling.troubles': arguments['troubles'],
        },
    )
    respawn = {'respawn': arguments['respawn'] == 'true', 'respawn_delay': 1.0}
    return [
        RegisterEventHandler(
            OnProcessExit(target_action=board, on_exit=[Shutdown(reason='the drive is over')])
        ),
        board,
        camera,
        arguments.node(
            'driver', {'driver.port': str(port), 'driver.publish_odom_transform': True}, **respawn
        ),
        arguments.node('tracker', **respawn),
        arguments.calibrator(follows_tracker=True, parameters={}, **respawn),
    ]


def generate_launch_description() -> LaunchDescription:
    """Return the launch description, for `ros2 launch`."""
    return describe(ARGUMENTS, nodes)
