"""A graph of its own for every test: nodes as real processes, and a listener among them.

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
"""What has not happened by then does not happen; machines under test are slow."""
PROJECT = Path(__file__).resolve().parents[2]


class NodeProcess:
    """A node that runs as it does on a robot: a process of its own."""

    def __init__(self, name: str, arguments: Sequence[str], domain: int) -> None:
        """Start it.

        Args:
            name: one of the nodes of this package.
            arguments: what stands behind `--ros-args`.
            domain: ROS_DOMAIN_ID.
        """
        self.name = name
        self.told_to_end = False
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
    def said(self) -> str:
        """All it has printed so far."""
        self._log.seek(0)
        return self._log.read()

    def send(self, number: signal.Signals) -> None:
        """Send it a signal; whatever it does then is no surprise."""
        self.told_to_end = True
        self._process.send_signal(number)

    def stop(self, number: signal.Signals = signal.SIGTERM) -> int:
        """Tell it to end (or, with SIGKILL, end it) and return its exit status."""
        if self.status is None:
            self.send(number)
        return self._process.wait(WITHIN_S)

    def kill(self) -> None:
        """End it, whatever it does."""
        self._process.kill()
        self._process.wait()
        self._log.close()


def claim_domain() -> tuple[int, socket.socket]:
    """A ROS_DOMAIN_ID that no other test uses while the socket is open, as ROS's domain_coordinator does."""
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
    """Nodes in a domain of their own, and one node of the test among them, `self.node`."""

    def __init__(self, namespace: str = '') -> None:
        """Join.

        Args:
            namespace: of the test's own node.
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
                print(f'--- {process.name} (pid {process.pid}, exit status {process.status}) said:')
                print(process.said)
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
            name: which.
            namespace: its namespace.
            parameters: by name; a string is passed as a string.
            arguments: more of `--ros-args`, as `('-r', 'a:=b')`.
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
        """Let one message come in that waits, or comes within that time."""
        self._executor.spin_once(for_s)

    def wait(self, until: Callable[[], T | None], what: str, within_s: float = WITHIN_S) -> T:
        """Spin until something holds, and return it.

        Args:
            until: returns something true when it does.
            what: what is waited for, for the message of the failure.
            within_s: fails after so long.
        """
        end_s = time.monotonic() + within_s
        while not (found := until()):
            assert time.monotonic() < end_s, f'waited {within_s:.0f} s in vain for {what}'
            for process in self.processes:
                alive = process.told_to_end or process.status is None
                assert alive, f'{process.name} ended while the test waited for {what}'
            self.spin()
        return found

    def listen(self, kind: type[Any], topic: str, qos: QoSProfile | int = 1000) -> list[Any]:
        """Subscribe; the messages gather in the list that is returned, while the test spins."""
        gathered: list[Any] = []
        self.node.create_subscription(kind, topic, gathered.append, qos)
        return gathered

    def publisher(
        self, kind: type[Any], topic: str, qos: QoSProfile | int = 1000, *, readers: int = 1
    ) -> Publisher:
        """A publisher that already has so many subscribers."""
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
        """Call a service that turns something on or off."""
        return self.call(SetBool, service, SetBool.Request(data=on))

    def get_parameters(self, node: str, *names: str) -> list[Any]:
        """Values of parameters, as `ros2 param get` sees them; None where one is not set."""
        answer = self.call(GetParameters, f'{node}/get_parameters', GetParameters.Request(names=list(names)))
        return [parameter_value_to_python(value) for value in answer.values]

    def set_parameter(self, node: str, name: str, value: Any) -> SetParametersResult:
        """Set a parameter, as `ros2 param set` does; the result says whether it was taken and why not."""
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        return self.call(SetParameters, f'{node}/set_parameters', request).results[0]
