"""What the launch files share: their arguments, and the nodes with these as parameters."""

from __future__ import annotations

import os
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
    'params': ('', 'parameter file for all nodes; without one, the one that is shipped'),
    'namespace': ('', 'of the robot: stands before all its topics'),
    'model': ('', 'model.yaml with the effects to estimate; without one, the one that is shipped'),
    'calibration': (
        '',
        'calibration.yaml to start from and to keep up to date; without one, nothing is kept',
    ),
}
"""Arguments of every launch file, each with its default and meaning."""
OWN_TRANSFORMS = (('/tf', 'tf'), ('/tf_static', 'tf_static'))
"""Frames have the same names on all robots, so a robot with a namespace has transforms of its own."""


class Arguments:
    """The values of the arguments of a launch file."""

    def __init__(self, context: LaunchContext) -> None:
        self._context = context

    def __getitem__(self, name: str) -> str:
        return str(LaunchConfiguration(name).perform(self._context))

    @property
    def params(self) -> Path:
        """The parameter file."""
        shipped = Path(get_package_share_directory(PACKAGE)) / 'config' / 'gyrocal.yaml'
        return Path(self['params']).expanduser() if self['params'] else shipped

    def node(self, name: str, parameters: Mapping[str, Any] | None = None, **more: Any) -> Node:
        """One of our nodes, with the parameter file and, over it, the parameters that are not empty."""
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
        """The calibrator.

        Args:
            follows_tracker: the features come from our tracker, which is better than the usual one.
            parameters: further ones.
            more: of the node.
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
        arguments: beside the common ones: name to default (None: has to be given) and meaning.
        actions: what to start, once the values of the arguments are known.
    """
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=about)
        for name, (default, about) in {**arguments, **COMMON}.items()
    ]
    return LaunchDescription(
        [*declared, OpaqueFunction(function=lambda context: actions(Arguments(context)))]
    )
