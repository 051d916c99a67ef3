"""What RViz and Foxglove are told to show is what the nodes publish."""

from __future__ import annotations

import ast
import json
import re
from functools import cache
from pathlib import Path
from typing import Any

import yaml

from gyrocal_ros import nodes
from gyrocal_ros.calibration import announcement
from gyrocal_ros.config import Config, LiveConfig
from gyrocal_ros.effects import default_model
from gyrocal_ros.files import shipped
from gyrocal_ros.live.calibrator import LiveCalibrator
from gyrocal_ros.recording.topics import BODY_FRAME, MAP_FRAME, Role

SCRIPTS = '/studio_script/'
"""Before the names of topics that a script of the layout makes."""
OTHERS = {'/tf_static'}
"""Topics that come from somebody else on a real robot."""


@cache
def published() -> dict[str, tuple[str, str]]:
    """Type and quality of service of every topic that a node publishes, by its absolute name.

    They are read from the source, so that this needs no ROS.
    """
    found = {}
    for module in sorted(Path(nodes.__file__).parent.glob('*.py')):
        for call in ast.walk(ast.parse(module.read_text(encoding='utf-8'))):
            if not isinstance(call, ast.Call):
                continue
            function = ast.unparse(call.func)
            arguments = call.args[1:] if function == 'publish' else call.args
            if function != 'publish' and not function.endswith('.create_publisher'):
                continue
            kind, topic, quality = arguments
            if isinstance(topic, ast.Constant) and isinstance(topic.value, str):
                found[f'/{topic.value.lstrip("/")}'] = ast.unparse(kind), ast.unparse(quality)
            elif isinstance(topic, ast.Attribute) and ast.unparse(topic.value) == 'Role':
                found[f'/{Role[topic.attr]}'] = ast.unparse(kind), ast.unparse(quality)
    return found


def rviz() -> dict[str, Any]:
    """The configuration of RViz."""
    settings: dict[str, Any] = yaml.safe_load(shipped('config/gyrocal.rviz').read_text(encoding='utf-8'))
    return settings['Visualization Manager']


def foxglove() -> dict[str, Any]:
    """The layout of Foxglove."""
    layout: dict[str, Any] = json.loads(shipped('config/foxglove.json').read_text(encoding='utf-8'))
    return layout


def strings(value: Any) -> list[str]:
    """All strings and keys in nested values."""
    if isinstance(value, dict):
        return [*value, *(text for item in value.values() for text in strings(item))]
    if isinstance(value, list):
        return [text for item in value for text in strings(item)]
    return [value] if isinstance(value, str) else []


def foxglove_topics() -> set[str]:
    """Every topic that the panels of the layout name."""
    texts = strings(foxglove()['configById'])
    return {re.split(r'[.\[]', text)[0] for text in texts if text.startswith('/')}


def scripts() -> list[tuple[list[str], str]]:
    """Inputs and output of every script of the layout."""
    sources = [script['sourceCode'] for script in foxglove()['userNodes'].values()]
    return [
        (
            json.loads(re.findall(r'^export const inputs = (.*);$', source, re.MULTILINE)[0]),
            json.loads(re.findall(r'^export const output = (.*);$', source, re.MULTILINE)[0]),
        )
        for source in sources
    ]


def panels(place: Any) -> list[str]:
    """The panels at a place of the layout."""
    return [place] if isinstance(place, str) else [*panels(place['first']), *panels(place['second'])]


def test_the_source_tells_what_is_published() -> None:
    assert published()['/imu/data'] == ('Imu', 'SENSOR_OUT')
    assert published()['/ceiling_camera/features'] == ('PointCloud2', 'SENSOR_OUT')


def test_rviz_shows_topics_as_they_are_published() -> None:
    shown = [display for display in rviz()['Displays'] if 'Topic' in display]
    assert {display['Topic']['Value'] for display in shown} == {
        '/ceiling_map',
        '/odometry/slam',
        '/ceiling_camera/tracks_image',
    }
    for display in shown:
        kind, quality = published()[display['Topic']['Value']]
        assert display['Class'] == f'rviz_default_plugins/{kind}'
        latched = display['Topic']['Durability Policy'] == 'Transient Local'
        assert latched == (quality == 'LATCHED')


def test_rviz_stands_in_the_map_and_looks_at_the_robot() -> None:
    assert rviz()['Global Options']['Fixed Frame'] == MAP_FRAME
    assert rviz()['Views']['Current']['Target Frame'] == BODY_FRAME


def test_foxglove_names_topics_that_are_published() -> None:
    made = {output for _, output in scripts()}
    assert {'/gyro_calibration', '/ceiling_map', '/diagnostics', '/tf'} <= foxglove_topics()
    assert foxglove_topics() <= {*published(), *OTHERS, *made}


def test_foxglove_shows_every_panel_once() -> None:
    layout = foxglove()
    assert sorted(panels(layout['layout'])) == sorted(layout['configById'])


def test_foxglove_scripts_hear_what_is_published() -> None:
    assert scripts()
    for inputs, output in scripts():
        assert {*inputs} <= {*published()}
        assert output.startswith(SCRIPTS)


def test_foxglove_asks_for_numbers_that_are_told() -> None:
    live = LiveCalibrator(default_model(), Config(), LiveConfig(), name='', steady=True, now_s=0.0)
    told = announcement(live.calibration)
    texts = strings(foxglove())
    asked = {name for text in texts for name in re.findall(r'"(gyro\.\w+)"', text)}
    assert asked == {'gyro.scale_factor', 'gyro.scale_factor_std'}
    assert all(isinstance(told[name], float) for name in asked)
