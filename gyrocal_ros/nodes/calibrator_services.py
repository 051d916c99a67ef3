"""The services of the calibrator node: save, reset, and switch the estimation on or off."""

from __future__ import annotations

from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from gyrocal_ros.nodes.guard import Guard
from gyrocal_ros.robot.calibrator import LiveCalibrator


class CalibratorServices:
    """Serves the commands of a person to a calibrator."""

    def __init__(self, node: Node, live: LiveCalibrator, guard: Guard) -> None:
        self._live = live
        node.create_service(Trigger, '~/save', guard.service('~/save', self._save))
        node.create_service(Trigger, '~/reset', guard.service('~/reset', self._reset))
        node.create_service(SetBool, '~/estimate', guard.service('~/estimate', self._switch))

    def _save(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        problem = self._live.save()
        response.success, response.message = not problem, problem or 'saved'
        return response

    def _reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = True, self._live.reset() or 'restarted with the priors'
        return response

    def _switch(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._live.switch(request.data)
        response.success, response.message = True, 'estimating' if request.data else 'stopped'
        return response
