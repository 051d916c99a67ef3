"""Shared by the launch files: common arguments, and nodes that take them as parameters."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from gyrocal_ros.config.parameter_file import load_config

PACKAGE = 'gyrocal_ros'
COMMON = {
    'params': ('', 'parameter file for all nodes; the default is config/gyrocal.yaml of the package'),
    'namespace': ('', 'namespace of the robot, the prefix of all its topics'),
    'model': ('', 'model.yaml with the effects to estimate; the default is that of the package'),
    'calibration': (
        '',
        'calibration.yaml to start from and to keep up to date; by default nothing is saved',
    ),
}
"""Arguments of every launch file: default and meaning by name."""
OWN_TRANSFORMS = (('/tf', 'tf'), ('/tf_static', 'tf_static'))
"""Remappings of a robot with a namespace: frame names are the same on all robots, so that each needs its own
topics of transforms."""


class Arguments:
    """Values of the arguments of a launch file."""

    def __init__(self, context: LaunchContext) -> None:
        self._context = context

    def __getitem__(self, name: str) -> str:
        return str(LaunchConfiguration(name).perform(self._context))

    @property
    def params(self) -> Path:
        """Path of the parameter file."""
        shipped = Path(get_package_share_directory(PACKAGE)) / 'config' / 'gyrocal.yaml'
        return Path(self['params']).expanduser() if self['params'] else shipped

    def node(self, name: str, parameters: Mapping[str, Any] | None = None, **more: Any) -> Node:
        """Return a node of this package with the parameter file, overridden by the non-empty parameters."""
        given = {key: value for key, value in (parameters or {}).items() if value != ''}
        return Node(
            package=PACKAGE,
            executable=name,
            name=name,
            namespace=self['namespace'],
            parameters=[str(self.params), given],
            remappings=OWN_TRANSFORMS if self['namespace'] else (),
            output='screen',
            emulate_tty=True,
            **more,
        )

    def calibrator(self, *, follows_tracker: bool, parameters: Mapping[str, Any], **more: Any) -> Node:
        """Return the calibrator.

        Args:
            follows_tracker: True if the features come from the tracker of this package, whose pixel noise is
                set in the section `tracker`.
            parameters: further parameters.
            more: further arguments of the launch action.
        """
        noise = (
            {'camera.pixel_noise_px': load_config(self.params).tracker.noise_px} if follows_tracker else {}
        )
        files = {f'live.{name}': os.path.expanduser(self[name]) for name in ('model', 'calibration')}
        return self.node('calibrator', {**files, **noise, **parameters}, **more)


def describe(
    arguments: Mapping[str, tuple[str | None, str]], actions: Callable[[Arguments], list[Any]]
) -> LaunchDescription:
    """Make a launch description.

    Args:
        arguments: arguments besides the common ones: default (None: required) and meaning by name.
        actions: returns the launch actions for the values of the arguments.
    """
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=about)
        for name, (default, about) in {**arguments, **COMMON}.items()
    ]
    return LaunchDescription(
        [
            *declared,
            OpaqueFunction(function=lambda context: leave_interrupts_to_launch()),
            OpaqueFunction(function=lambda context: actions(Arguments(context))),
        ]
    )


def leave_interrupts_to_launch() -> None:
    """Keep Python from raising KeyboardInterrupt in the event loop of launch.

    Launch reads signals from the wakeup descriptor of Python and ends the nodes on SIGINT. The handler of
    Python raises KeyboardInterrupt besides, wherever launch is at that moment. If that is the start of a
    process, as when a killed node is restarted, launch never learns of the end of that process and waits for
    it forever, whatever else it receives. A handler that does nothing leaves the descriptor as it is.
    """
    is_main = threading.current_thread() is threading.main_thread()
    if is_main and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, lambda number, frame: None)
