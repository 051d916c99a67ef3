"""Settings files: ROS 2 parameter files, used by the nodes and the command line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from gyrocal_ros.config.declare import with_settings
from gyrocal_ros.config.robot_sections import RobotConfig
from gyrocal_ros.config.sections import Config
from gyrocal_ros.config.yaml_file import read_yaml
from gyrocal_ros.errors import ConfigError

PARAMETERS_OF_ROS = ('use_sim_time', 'qos_overrides', 'start_type_description_service')
"""Parameters that every node has and that a file may contain."""


def load_config(path: Path | None) -> Config:
    """Load the estimator's settings from a ROS 2 parameter file, or the defaults if `path` is None.

    Raises:
        ConfigError: the file cannot be read, or a setting in it is unknown or out of bounds.
    """
    return load_all(path)[0]


def load_all(path: Path | None) -> tuple[Config, RobotConfig]:
    """Load all settings from a ROS 2 parameter file, or the defaults if `path` is None.

    Raises:
        ConfigError: the file cannot be read, or a setting in it is unknown or out of bounds.
    """
    estimator, robot = Config(), RobotConfig()
    for node_name, node in read_yaml(path).items() if path else ():
        parameters = node.get('ros__parameters') if isinstance(node, Mapping) else None
        if not isinstance(parameters, Mapping):
            raise ConfigError(
                f'{node_name!r} has no ros__parameters', where=str(path), todo='write a ROS 2 parameter file'
            )
        for name in node:
            if name != 'ros__parameters':
                todo = 'move it under ros__parameters'
                raise ConfigError(f'{node_name}: {name!r} is not known here', where=str(path), todo=todo)
        nested = _nested(parameters)
        robot_settings = {name: nested.pop(name) for name in _sections(RobotConfig) if name in nested}
        robot = with_settings(robot, robot_settings, str(path))
        estimator = with_settings(estimator, nested, str(path))
    return estimator, robot


def _nested(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parameters of a node without those of ROS; `section.setting` may stand for nested ones."""
    nested: dict[str, Any] = {}
    for name, value in parameters.items():
        section, _, item = str(name).partition('.')
        if section in PARAMETERS_OF_ROS:
            continue
        value = {item: value} if item else value
        before = nested.get(section, {})
        if isinstance(before, Mapping):  # anything else is refused later
            nested[section] = {**before, **value} if isinstance(value, Mapping) else value
    return nested


def _sections(kind: type[Any]) -> list[str]:
    return [item.name for item in fields(kind)]
