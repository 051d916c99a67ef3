"""The calibrator as a process, with a heading reference in place of the ceiling camera."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from graph import Graph
from rosidl_runtime_py.utilities import get_message
from sensor_msgs.msg import Imu
from tf2_msgs.msg import TFMessage

from gyrocal_ros.data import HeadingSample, ImuSample, Mount
from gyrocal_ros.msgs import to_ros, topics
from gyrocal_ros.nodes.qos import SENSOR_OUT, STATIC
from gyrocal_ros.sim.references import ReferenceSource
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.world import SimSource

DURATION_S = 32.0
IN_FLIGHT = 5
"""Maximum number of unanswered IMU samples, well within the reorder window."""


@pytest.mark.parametrize('reference', ['/pf/pose', 'tf:map:base_link'])
def test_it_calibrates_from_a_topic_or_a_frame(reference: str) -> None:
    scenario = replace(find_scenario('cleaning'), duration_s=DURATION_S, imu_hz=25)
    source, make = ReferenceSource(SimSource(scenario, 4), 'visual'), to_ros.live_maker(get_message)
    with Graph() as graph:
        graph.start('calibrator', parameters={'use_sim_time': True, 'live.heading_reference': reference})
        outputs, health = graph.listen(Imu, 'imu/data'), graph.listen(DiagnosticArray, '/diagnostics')
        imu = graph.publisher(Imu, 'imu/data_raw', SENSOR_OUT)
        static = graph.publisher(TFMessage, '/tf_static', STATIC)
        mounts = {topics.IMU_FRAME: Mount(np.eye(3), np.zeros(3))}
        static.publish(to_ros.static_transforms(make, mounts, source.span.start_ns))
        static.wait_for_all_acked()
        before_ns = [0] * IN_FLIGHT
        is_frame = reference.startswith('tf:')
        kind: Any = TFMessage if is_frame else PoseStamped
        headings = graph.publisher(kind, '/tf' if is_frame else reference, SENSOR_OUT)
        graph.wait(lambda: health, 'the calibrator')  # which knows the mount of the IMU by then
        for sample in source.measurements():
            if isinstance(sample, ImuSample):
                imu.publish(to_ros.imu(make, sample))
                before_ns.append(sample.t_ns)
                wait_for_stamp(graph, outputs, before_ns.pop(0))
            elif isinstance(sample, HeadingSample):
                pose = to_ros.heading(make, sample)
                headings.publish(as_frame(make, pose) if is_frame else pose)

        def is_known() -> bool:
            values = {item.key: item.value for array in health for s in array.status for item in s.values}
            return float(values.get('scale_factor_std', 1.0)) < 0.02

        graph.wait(is_known, 'a scale factor by the reference')
        values = {item.key: item.value for array in health for s in array.status for item in s.values}
        std, error = float(values['scale_factor_std']), float(values['scale_factor'])
        assert abs(error - source.truth.scale_factor) < max(4.0 * std, 0.002)
        assert 'reference_time_offset_s' in values


def wait_for_stamp(graph: Graph, outputs: list[Any], t_ns: int) -> None:
    """Wait for the output with this stamp."""
    graph.wait(lambda: t_ns == 0 or (outputs and topics.stamp_ns(outputs[-1]) >= t_ns), 'calibrated samples')


def as_frame(make: to_ros.MessageMaker, pose: PoseStamped) -> TFMessage:
    """Return a pose as the transform from the map to the body."""
    q = pose.pose.orientation
    transform = make(
        'geometry_msgs/msg/TransformStamped',
        header=pose.header,
        child_frame_id='base_link',
        transform=make(
            'geometry_msgs/msg/Transform',
            translation=make('geometry_msgs/msg/Vector3', x=0.0, y=0.0, z=0.0),
            rotation=q,
        ),
    )
    transform.header.frame_id = 'map'
    return make(topics.TRANSFORMS, transforms=[transform])
