"""An isolated ROS graph for each test: nodes as real processes, and one node of the test.

with Graph() as graph:
    graph.start('calibrator', parameters={'live.estimate': False})
    latest = graph.listen(ParameterEvent, 'gyro_calibration', LATCHED)
    graph.wait(lambda: latest, 'the calibration')
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

import rclpy
import yaml
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from std_srvs.srv import SetBool, Trigger

T = TypeVar('T')

WITHIN_S = 30.0
"""Timeout of a wait, long enough for a slow machine."""
PROJECT = Path(__file__).resolve().parents[2]


class NodeProcess:
    """A node in its own process, as on a robot."""

    def __init__(self, name: str, arguments: Sequence[str], domain: int) -> None:
        """Start it.

        Args:
            name: one of the nodes of this package.
            arguments: the arguments after `--ros-args`.
            domain: ROS_DOMAIN_ID.
        """
        self.name = name
        self.may_end = False
        self._log = tempfile.TemporaryFile('w+')  # noqa: SIM115, closed in kill
        path = os.pathsep.join([str(PROJECT), os.environ.get('PYTHONPATH', '')])
        self._process = subprocess.Popen(
            [sys.executable, '-m', 'gyrocal_ros.nodes', name, '--ros-args', *arguments],
            env={**os.environ, 'ROS_DOMAIN_ID': str(domain), 'PYTHONPATH': path, 'PYTHONUNBUFFERED': '1'},
            stdout=self._log,
            stderr=subprocess.STDOUT,
        )

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def status(self) -> int | None:
        """Exit status, None while it runs."""
        return self._process.poll()

    @property
    def output(self) -> str:
        """Everything printed so far."""
        self._log.seek(0)
        return self._log.read()

    def send(self, number: signal.Signals) -> None:
        """Send a signal, after which the process may end."""
        self.may_end = True
        self._process.send_signal(number)

    def stop(self, number: signal.Signals = signal.SIGTERM) -> int:
        """Send a signal, wait for the end of the process, and return its exit status."""
        if self.status is None:
            self.send(number)
        return self._process.wait(WITHIN_S)

    def kill(self) -> None:
        """Kill the process."""
        self._process.kill()
        self._process.wait()
        self._log.close()


def claim_domain() -> tuple[int, socket.socket]:
    """Claim a ROS_DOMAIN_ID while the returned socket is open, as ROS's domain_coordinator does."""
    for domain in range(20, 100):
        claim = socket.socket()
        try:
            claim.bind(('', 32768 + domain))
        except OSError:
            claim.close()
        else:
            return domain, claim
    raise AssertionError('all domains are in use')


class Graph:
    """Nodes in their own ROS domain, and the node of the test, `self.node`."""

    def __init__(self, namespace: str = '') -> None:
        """Claim a domain and make the node of the test.

        Args:
            namespace: namespace of the node of the test.
        """
        self.domain, self._claim = claim_domain()
        self._context = Context()
        rclpy.init(context=self._context, domain_id=self.domain)
        self.node = rclpy.create_node('test', context=self._context, namespace=namespace)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self.processes: list[NodeProcess] = []

    def __enter__(self) -> Graph:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for process in self.processes:
            if error is not None:
                print(f'--- {process.name} (pid {process.pid}, exit status {process.status}) printed:')
                print(process.output)
            process.kill()
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)
        self._claim.close()

    def start(
        self,
        name: str,
        *,
        namespace: str = '',
        parameters: Mapping[str, Any] | None = None,
        arguments: Sequence[str] = (),
    ) -> NodeProcess:
        """Start a node of this package.

        Args:
            name: name of the node.
            namespace: namespace of the node.
            parameters: parameters by name; a string stays a string.
            arguments: further ROS arguments, as `('-r', 'a:=b')`.
        """
        given = [
            f'{name}:={yaml.safe_dump(value).splitlines()[0]}' for name, value in (parameters or {}).items()
        ]
        chosen = ['-r', f'__ns:=/{namespace.strip("/")}'] if namespace else []
        for item in given:
            chosen += ['-p', item]
        process = NodeProcess(name, [*chosen, *arguments], self.domain)
        self.processes.append(process)
        return process

    def spin(self, for_s: float = 0.1) -> None:
        """Process one callback, if one is ready within a time."""
        self._executor.spin_once(for_s)

    def wait(self, condition: Callable[[], T | None], what: str, within_s: float = WITHIN_S) -> T:
        """Spin until a condition is true; return its value.

        Args:
            condition: returns a true value when the wait is over.
            what: description of the condition, for the failure message.
            within_s: timeout.
        """
        end_s = time.monotonic() + within_s
        while not (found := condition()):
            assert time.monotonic() < end_s, f'timeout after {within_s:.0f} s of waiting for {what}'
            for process in self.processes:
                alive = process.may_end or process.status is None
                assert alive, f'{process.name} ended while the test waited for {what}'
            self.spin()
        return found

    def listen(self, kind: type[Any], topic: str, qos: QoSProfile | int = 1000) -> list[Any]:
        """Subscribe; return the list to which messages are appended while the test spins."""
        received: list[Any] = []
        self.node.create_subscription(kind, topic, received.append, qos)
        return received

    def publisher(
        self, kind: type[Any], topic: str, qos: QoSProfile | int = 1000, *, readers: int = 1
    ) -> Publisher:
        """Make a publisher and wait for its subscribers."""
        publisher = self.node.create_publisher(kind, topic, qos)
        self.wait(lambda: publisher.get_subscription_count() >= readers, f'a subscriber of {topic}')
        return publisher

    def call(self, kind: type[Any], service: str, request: Any) -> Any:
        """Call a service."""
        client = self.node.create_client(kind, service)
        self.wait(client.service_is_ready, f'the service {service}')
        future = client.call_async(request)
        self.wait(future.done, f'the answer of {service}')
        self.node.destroy_client(client)
        return future.result()

    def trigger(self, service: str) -> Trigger.Response:
        """Call a service without arguments."""
        return self.call(Trigger, service, Trigger.Request())

    def switch(self, service: str, on: bool) -> SetBool.Response:
        """Call a service that switches something on or off."""
        return self.call(SetBool, service, SetBool.Request(data=on))

    def get_parameters(self, node: str, *names: str) -> list[Any]:
        """Return the values of parameters, as `ros2 param get` does; None for one that is not set."""
        answer = self.call(GetParameters, f'{node}/get_parameters', GetParameters.Request(names=list(names)))
        return [parameter_value_to_python(value) for value in answer.values]

    def set_parameter(self, node: str, name: str, value: Any) -> SetParametersResult:
        """Set a parameter, as `ros2 param set` does; return success and reason."""
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        return self.call(SetParameters, f'{node}/set_parameters', request).results[0]
