"""The calibration for all others: latched on a topic, and as parameters of the node."""

from __future__ import annotations

from collections.abc import Sequence

from rcl_interfaces.msg import ParameterDescriptor, ParameterEvent, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from gyrocal_ros.msgs.outputs import parameter_event
from gyrocal_ros.msgs.to_ros import MessageMaker
from gyrocal_ros.nodes.qos import LATCHED
from gyrocal_ros.pipeline.calibration import Calibration, announcement


class Announcer:
    """Tells the calibration; to be asked at most once a second.

    Args:
        node: whose parameters tell it too.
        make: makes messages.
        calibration: the first.
    """

    def __init__(self, node: Node, make: MessageMaker, calibration: Calibration) -> None:
        self._node, self._make = node, make
        self._told = announcement(calibration)
        self._is_telling = False
        self._publisher = node.create_publisher(ParameterEvent, 'gyro_calibration', LATCHED)
        for name, value in self._told.items():
            about = ParameterDescriptor(description='estimated by this node; told by gyro_calibration too')
            node.declare_parameter(name, value, about, ignore_override=True)
        node.add_on_set_parameters_callback(self._refuse_others)
        self._publish()

    def tell(self, calibration: Calibration) -> None:
        """Tell it, if it is not what was told last."""
        values = announcement(calibration)
        if values == self._told:
            return
        self._told, self._is_telling = values, True
        parameters = [Parameter(name, value=value) for name, value in values.items()]
        result = self._node.set_parameters_atomically(parameters)
        assert result.successful, result.reason
        self._is_telling = False
        self._publish()

    def _publish(self) -> None:
        now_ns = self._node.get_clock().now().nanoseconds
        name = self._node.get_fully_qualified_name()
        self._publisher.publish(parameter_event(self._make, now_ns, name, self._told))

    def _refuse_others(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        others = [parameter.name for parameter in parameters if parameter.name in self._told]
        if others and not self._is_telling:
            reason = f'{others[0]} is estimated by this node; to forget what it knows call its service reset'
            return SetParametersResult(successful=False, reason=reason)
        return SetParametersResult(successful=True)
