"""The views of the robot that are shipped show what the nodes publish."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest
import yaml

from gyrocal_ros.files import shipped
from gyrocal_ros.msgs.topics import Role

PUBLISHED = {
    *(f'/{role}' for role in Role),
    '/ceiling_camera/tracks_image',
    '/ceiling_camera/search_regions',
    '/ceiling_map',
    '/diagnostics',
    '/gyro_calibration',
    '/imu/data',
    '/odometry/slam',
}
"""As docs and interface name them."""


def parts(tree: Any) -> Iterator[Any]:
    """A tree of lists and mappings with all that is in it."""
    yield tree
    for item in tree.values() if isinstance(tree, dict) else tree if isinstance(tree, list) else ():
        yield from parts(item)


@pytest.fixture(scope='module')
def rviz() -> Any:
    return yaml.safe_load(shipped('config/gyrocal.rviz').read_text(encoding='utf-8'))


@pytest.fixture(scope='module')
def foxglove() -> Any:
    return json.loads(shipped('config/foxglove.json').read_text(encoding='utf-8'))


def test_rviz_shows_image_map_and_path(rviz: Any) -> None:
    displays = rviz['Visualization Manager']['Displays']
    shown = {
        item['Class'].split('/')[1]: item['Topic']['Value']
        for item in displays
        if item['Value'] and 'Topic' in item
    }
    assert shown == {
        'Image': '/ceiling_camera/tracks_image',
        'MarkerArray': '/ceiling_map',
        'Odometry': '/odometry/slam',
    }
    assert rviz['Visualization Manager']['Global Options']['Fixed Frame'] == 'map'


def test_rviz_names_topics_that_there_are(rviz: Any) -> None:
    topics = {item['Topic']['Value'] for item in parts(rviz) if isinstance(item, dict) and 'Topic' in item}
    assert topics <= PUBLISHED


def test_rviz_gets_the_map_also_when_it_comes_late(rviz: Any) -> None:
    topics = [item['Topic'] for item in parts(rviz) if isinstance(item, dict) and 'Topic' in item]
    latched = [topic['Value'] for topic in topics if topic['Durability Policy'] == 'Transient Local']
    assert latched == ['/ceiling_map']


def test_foxglove_places_every_panel_once(foxglove: Any) -> None:
    placed = [item for item in parts(foxglove['layout']) if isinstance(item, str) and '!' in item]
    assert sorted(placed) == sorted(foxglove['configById'])


def test_foxglove_names_topics_that_there_are(foxglove: Any) -> None:
    made = {f'/studio_script/{name}' for name in foxglove['userNodes']}
    panels = foxglove['configById']
    topics = {
        panels['Image!tracks']['imageMode']['imageTopic'],
        panels['DiagnosticSummary!health']['topicToRender'],
        *panels['3D!map']['topics'],
    }
    assert topics <= PUBLISHED
    plotted = [path['value'].rpartition('.') for path in panels['Plot!scale']['paths']]
    assert {topic for topic, _, _ in plotted} == made


def test_foxglove_plots_the_path_to_one_scale(foxglove: Any) -> None:
    panel = foxglove['configById']['Plot!path']
    along, across = (path['value'].rpartition('.') for path in (panel['xAxisPath'], *panel['paths']))
    assert along[0] == across[0] == '/odometry/slam.pose.pose.position'
    assert (along[2], across[2]) == ('x', 'y')
    assert panel['axisScalesMode'] == 'lockedScales'


def test_foxglove_computes_the_band_of_the_scale_factor(foxglove: Any) -> None:
    (script,) = [node['sourceCode'] for node in foxglove['userNodes'].values()]
    assert 'inputs = ["/gyro_calibration"]' in script
    assert 'output = "/studio_script/gyro_scale_factor"' in script
    for path in foxglove['configById']['Plot!scale']['paths']:
        assert f'{path["value"].rpartition(".")[2]}: number' in script
    for parameter in ('gyro.scale_factor', 'gyro.scale_factor_std'):
        assert f'numbers["{parameter}"]' in script
