"""Settings as ROS parameters: declared, checked and changed by the one declaration in `config`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Generic

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.exceptions import ParameterException
from rclpy.node import Node
from rclpy.parameter import Parameter

from gyrocal_ros.config.declare import Sections, Setting, flat_settings, plain, with_settings
from gyrocal_ros.errors import ConfigError


def descriptor_of(value: Any, about: Setting) -> ParameterDescriptor:
    """Return the ParameterDescriptor of a setting."""
    unit = f' [{about.unit}]' if about.unit else ''
    descriptor = ParameterDescriptor(description=f'{about.help}{unit}', read_only=not about.live)
    if about.choices:
        descriptor.additional_constraints = f'one of {", ".join(about.choices)}'
    if about.low is not None and about.high is not None:
        if isinstance(value, int):
            descriptor.integer_range = [IntegerRange(from_value=int(about.low), to_value=int(about.high))]
        elif isinstance(value, float):
            descriptor.floating_point_range = [FloatingPointRange(from_value=about.low, to_value=about.high)]
        else:
            descriptor.additional_constraints = f'each from {about.low:g} to {about.high:g}'
    return descriptor


class Settings(Generic[Sections]):
    """Sections of the settings as parameters of a node.

    Args:
        node: the node; gets a parameter `section.setting` for each setting.
        config: the default values.
        sections: names of the sections that the node uses.
        on_change: called with the new settings when a parameter has changed.

    Raises:
        ConfigError: a value given at the start is of the wrong type or out of bounds.
    """

    def __init__(
        self,
        node: Node,
        config: Sections,
        sections: Sequence[str],
        on_change: Callable[[Sections], None] = lambda config: None,
    ) -> None:
        self.config = config
        self._on_change = on_change
        self._where = f'parameters of {node.get_fully_qualified_name()}'
        chosen = [item for item in flat_settings(config) if item[0].split('.')[0] in sections]
        self._names = {name for name, _, _ in chosen}
        for name, value, about in chosen:
            try:
                node.declare_parameter(name, plain(value), descriptor_of(value, about))
            except ParameterException as error:
                raise ConfigError(str(error), where=self._where, todo=_bounds(name, about)) from error
        self.config = self._with([node.get_parameter(name) for name in self._names])
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._apply)

    def _with(self, parameters: Sequence[Parameter]) -> Sections:
        nested: dict[str, dict[str, Any]] = {}
        for parameter in parameters:
            section, _, item = parameter.name.partition('.')
            if parameter.name in self._names:
                value = parameter.value
                nested.setdefault(section, {})[item] = (
                    value if isinstance(value, (bool, int, float, str)) else list(value)
                )
        return with_settings(self.config, nested, self._where)

    def _check(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        try:
            self._with(parameters)
        except ConfigError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply(self, parameters: Sequence[Parameter]) -> None:
        if any(parameter.name in self._names for parameter in parameters):
            self.config = self._with(parameters)
            self._on_change(self.config)


def _bounds(name: str, about: Setting) -> str:
    bounds = '' if about.low is None else f' from {about.low} to {about.high} {about.unit}'.rstrip()
    return f'{name} is {about.help}{bounds}'
