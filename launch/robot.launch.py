"""The robot: driver, tracker and calibrator. The driver of the camera has to be started separately."""

from launch import LaunchDescription

from gyrocal_ros.nodes.launching import Arguments, describe

ARGUMENTS = {
    'port': ('', 'serial port of the IMU and encoder board; the default is that of the parameter file'),
    'respawn': ('true', 'restart a node when it ends by itself'),
}


def nodes(arguments: Arguments) -> list:
    """Return the nodes of the robot."""
    respawn = {'respawn': arguments['respawn'] == 'true', 'respawn_delay': 1.0}
    return [
        arguments.node('driver', {'driver.port': arguments['port']}, **respawn),
        arguments.node('tracker', **respawn),
        arguments.calibrator(follows_tracker=True, parameters={}, **respawn),
    ]


def generate_launch_description() -> LaunchDescription:
    """Return the launch description, for `ros2 launch`."""
    return describe(ARGUMENTS, nodes)
