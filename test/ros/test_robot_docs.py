"""The example of the page about the robot, run as a node beside the calibrator."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from graph import PROJECT, WITHIN_S, Graph
from rcl_interfaces.msg import ParameterEvent

from gyrocal_ros.config.robot_sections import LiveConfig
from gyrocal_ros.config.sections import Config
from gyrocal_ros.effects import default_model
from gyrocal_ros.nodes.qos import LATCHED
from gyrocal_ros.pipeline.calibration import Calibration, save_calibration
from gyrocal_ros.robot.calibrator import LiveCalibrator

PAGE = PROJECT / 'docs' / 'robot.md'


def example(language: str) -> str:
    """Return the only code block of the page in a language."""
    (code,) = re.findall(
        rf'^```{language}\n(.*?)^```', PAGE.read_text(encoding='utf-8'), re.DOTALL | re.MULTILINE
    )
    return code


def saved() -> Calibration:
    """Return a calibration as an earlier run may have saved it."""
    live = LiveCalibrator(default_model(), Config(), LiveConfig(), name='test', steady=True, now_s=0.0)
    start = live.calibration
    values = start.values.copy()
    values[:2] = 0.00125, -0.0745
    return replace(start, values=values, covariance=1e-8 * start.covariance, converged=True)


@contextmanager
def running(code: str, folder: Path, domain: int) -> Iterator[Path]:
    """Run a script as a process; yield the file with its output."""
    script, printed = folder / 'example.py', folder / 'printed.txt'
    script.write_text(code, encoding='utf-8')
    with printed.open('w') as output:
        process = subprocess.Popen(
            [sys.executable, '-u', str(script)],
            env={**os.environ, 'ROS_DOMAIN_ID': str(domain)},
            stdout=output,
            stderr=subprocess.STDOUT,
        )
        try:
            yield printed
        finally:
            process.kill()
            process.wait(WITHIN_S)


def test_the_python_example_receives_a_calibration_published_before_its_start(tmp_path: Path) -> None:
    path = tmp_path / 'calibration.yaml'
    save_calibration(saved(), Config(), path)
    with Graph() as graph:
        graph.start('calibrator', parameters={'live.calibration': str(path), 'live.estimate': False})
        events = graph.listen(ParameterEvent, 'gyro_calibration', LATCHED)
        graph.wait(lambda: events, 'the calibration')
        with running(example('python'), tmp_path, graph.domain) as printed:
            graph.wait(printed.read_text, 'a line of the example')
            graph.wait(lambda: printed.read_text().endswith('\n'), 'the rest of the line')
            assert printed.read_text().splitlines()[0] == 'true rate = 0.92550 * rate + 0.00125 rad/s'
