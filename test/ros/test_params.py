"""Settings as parameters of a real node."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter

from gyrocal_ros.config.declare import flat_settings, plain
from gyrocal_ros.config.robot_sections import RobotConfig
from gyrocal_ros.config.sections import Config
from gyrocal_ros.errors import ConfigError
from gyrocal_ros.nodes.params import Settings


@pytest.fixture
def context() -> Iterator[Context]:
    context = Context()
    rclpy.init(context=context)
    yield context
    context.try_shutdown()


def make_node(context: Context, *overrides: Parameter) -> Node:
    return Node('settings', context=context, parameter_overrides=list(overrides))


def changed(node: Node, name: str, value: Any) -> tuple[bool, str]:
    result = node.set_parameters([Parameter(name, value=value)])[0]
    return result.successful, result.reason


def every(config: Any) -> Sequence[str]:
    return sorted({name.split('.')[0] for name, _, _ in flat_settings(config)})


@pytest.mark.parametrize('config', [Config(), RobotConfig()], ids=['estimator', 'robot'])
def test_every_setting_is_a_parameter_with_its_description(context: Context, config: Any) -> None:
    node = make_node(context)
    assert Settings(node, config, every(config)).config == config
    for name, value, about in flat_settings(config):
        parameter, descriptor = node.get_parameter(name), node.describe_parameter(name)
        got = parameter.value if isinstance(value, (bool, int, float, str)) else list(parameter.value)
        assert got == plain(value)
        assert about.help in descriptor.description and about.unit in descriptor.description
        assert descriptor.read_only is not about.live
        for bounds in (*descriptor.floating_point_range, *descriptor.integer_range):
            assert (bounds.from_value, bounds.to_value) == (about.low, about.high)


def test_values_given_at_the_start_are_used(context: Context) -> None:
    given = (
        Parameter('board.gyro_zero', value=[1.0, 2.0, 3.0]),
        Parameter('driver.port', value='/dev/ttyUSB7'),
    )
    config = Settings(make_node(context, *given), RobotConfig(), ['board', 'driver']).config
    assert config.board.gyro_zero == (1.0, 2.0, 3.0)
    assert config.driver.port == '/dev/ttyUSB7'
    assert config.live == RobotConfig().live


@pytest.mark.parametrize(
    ('name', 'value', 'message'),
    [
        ('driver.baud_rate', 3, 'baud_rate'),
        ('driver.baud_rate', 'fast', 'baud_rate'),
        ('board.tick_m', 5.0, 'tick_m'),
        ('board.gyro_zero', [1.0, 2.0], 'must be 3 numbers'),
    ],
)
def test_invalid_values_at_the_start_are_refused(
    context: Context, name: str, value: Any, message: str
) -> None:
    node = make_node(context, Parameter(name, value=value))
    with pytest.raises(ConfigError, match=message) as caught:
        Settings(node, RobotConfig(), ['board', 'driver'])
    assert '/settings' in caught.value.where


def test_a_change_at_run_time_is_applied_or_refused_with_the_reason(context: Context) -> None:
    node = make_node(context)
    changes: list[Config] = []
    settings = Settings(node, Config(), ['gyro', 'features', 'convergence'], changes.append)
    assert changed(node, 'features.map_size', 40) == (True, '')
    assert settings.config.features.map_size == 40
    assert [config.features.map_size for config in changes] == [40]

    for name, value, reason in (
        ('features.map_size', 2, 'map_size'),
        ('features.map_size', 'many', 'parameter type'),
        ('features.parametrisation', 'pixel', 'read-only'),
        ('convergence.scale_std', float('nan'), 'scale_std'),
    ):
        successful, why = changed(node, name, value)
        assert not successful and reason in why, (name, why)
    assert len(changes) == 1 and settings.config == changes[0]


def test_other_parameters_are_ignored(context: Context) -> None:
    node = make_node(context)
    changes: list[Config] = []
    Settings(node, Config(), ['rest'], changes.append)
    node.declare_parameter('mine', 1)
    assert changed(node, 'mine', 2) == (True, '')
    assert changes == []
