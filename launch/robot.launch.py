"""The robot: driver, tracker and calibrator. The camera's driver is not ours; start it beside this."""

from launch import LaunchDescription

from gyrocal_ros.nodes.launching import Arguments, describe

ARGUMENTS = {
    'port': ('', 'serial port of the IMU and encoder board; without one, that of the parameter file'),
    'respawn': ('true', 'start a node again when it ends by itself'),
}


def nodes(arguments: Arguments) -> list:
    """What runs on the robot."""
    again = {'respawn': arguments['respawn'] == 'true', 'respawn_delay': 1.0}
    return [
        arguments.node('driver', {'driver.port': arguments['port']}, **again),
        arguments.node('tracker', **again),
        arguments.calibrator(follows_tracker=True, parameters={}, **again),
    ]


def generate_launch_description() -> LaunchDescription:
    """What `ros2 launch` asks for."""
    return describe(ARGUMENTS, nodes)
