"""Publishes the calibration: on a latched topic, and as read-only parameters of the node."""

from __future__ import annotations

from collections.abc import Sequence

from rcl_interfaces.msg import ParameterDescriptor, ParameterEvent, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from gyrocal_ros.msgs.outputs import parameter_event
from gyrocal_ros.msgs.to_ros import MessageMaker
from gyrocal_ros.nodes.qos import LATCHED
from gyrocal_ros.pipeline.calibration import Calibration, announcement


class CalibrationPublisher:
    """Publisher of the calibration.

    Args:
        node: the node; gets the parameters.
        make: makes messages.
        calibration: the first calibration.
    """

    def __init__(self, node: Node, make: MessageMaker, calibration: Calibration) -> None:
        self._node, self._make = node, make
        self._values = announcement(calibration)
        self._is_updating = False
        self._publisher = node.create_publisher(ParameterEvent, 'gyro_calibration', LATCHED)
        for name, value in self._values.items():
            about = ParameterDescriptor(
                description='estimated by this node; also published on gyro_calibration'
            )
            node.declare_parameter(name, value, about, ignore_override=True)
        node.add_on_set_parameters_callback(self._check)
        self._publish()

    def update(self, calibration: Calibration) -> None:
        """Publish a calibration if it has changed; to be called at most once a second."""
        values = announcement(calibration)
        if values == self._values:
            return
        self._values, self._is_updating = values, True
        parameters = [Parameter(name, value=value) for name, value in values.items()]
        result = self._node.set_parameters_atomically(parameters)
        assert result.successful, result.reason
        self._is_updating = False
        self._publish()

    def _publish(self) -> None:
        now_ns = self._node.get_clock().now().nanoseconds
        name = self._node.get_fully_qualified_name()
        self._publisher.publish(parameter_event(self._make, now_ns, name, self._values))

    def _check(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        """Refuse changes by others."""
        estimated = [parameter.name for parameter in parameters if parameter.name in self._values]
        if estimated and not self._is_updating:
            reason = (
                f'{estimated[0]} is estimated by this node; call its service reset to discard the estimate'
            )
            return SetParametersResult(successful=False, reason=reason)
        return SetParametersResult(successful=True)
