"""Processor time per image: decoding, tracker and filter apart."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

from gyrocal_ros.bag.selection import select_topics
from gyrocal_ros.bag.source import open_bag, topic_options
from gyrocal_ros.bag.storage import open_storage
from gyrocal_ros.bench.speed import gyrocal_process
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import FeatureObservations, Frame, Measurement, Rig, TruthSample
from gyrocal_ros.effects import default_model
from gyrocal_ros.ekf.slam import EkfSlam
from gyrocal_ros.errors import RecordingError
from gyrocal_ros.msgs import images
from gyrocal_ros.msgs.topics import Role
from gyrocal_ros.pipeline.visual_slam import VisualSlam

IMAGES = 400
"""Number of images that are timed, so that they fit into memory."""
SIMULATED_S = 30.0
"""Length of a simulated recording."""


def image_speed(bags: Sequence[Path]) -> Iterator[dict[str, Any]]:
    """Yield the processor times per image of recordings, or of a simulated one if there are none.

    decode_ms: from the message to a grey image.
    tracker_ms: tracker, aided by the filter.
    filter_ms: filter, with all samples of IMU and wheels.
    beyond_decoding_ms: tracker and filter.
    """
    for bag in bags:
        yield _row(bag)
    if not bags:
        with tempfile.TemporaryDirectory() as folder:
            bag = Path(folder) / 'simulated'
            gyrocal_process(
                'simulate', str(bag), '--scenario', 'filmed', '--duration', str(SIMULATED_S), '--images'
            )
            yield _row(bag)


def _row(bag: Path) -> dict[str, Any]:
    decoding_s = _decoding_s(bag)
    rig, measurements = _loaded(bag)
    seen: list[FeatureObservations] = []
    both_s = _processing_s(rig, measurements, seen)
    features = iter(seen)
    filter_s = _processing_s(rig, [next(features) if isinstance(m, Frame) else m for m in measurements], [])
    ms = 1e3 / len(seen)
    return {
        'bag': bag.name,
        'images': len(seen),
        'decode_ms': 1e3 * decoding_s,
        'tracker_ms': ms * (both_s - filter_s),
        'filter_ms': ms * filter_s,
        'beyond_decoding_ms': ms * both_s,
    }


def _decoding_s(bag: Path) -> float:
    """Return the processor time for the decoding of an image."""
    config = Config()
    with open_storage(bag) as storage:
        selection = select_topics(storage.topics, topic_options(config.recording, None, None, None))
        topic = selection.topics.get(Role.IMAGE)
        if topic is None:
            raise RecordingError('has no images of the ceiling', where=str(bag), todo='record the camera')
        messages = list(islice(storage.messages(topic), IMAGES))
    start_s = time.process_time()
    for message in messages:
        images.frame(message)
    return (time.process_time() - start_s) / max(len(messages), 1)


def _loaded(bag: Path) -> tuple[Rig, list[Measurement]]:
    """Return the measurements up to the last of `IMAGES` images."""
    source, count = open_bag(bag, Config()), 0
    measurements: list[Measurement] = []
    for measurement in source.measurements():
        count += isinstance(measurement, Frame)
        if count > IMAGES:
            break
        if not isinstance(measurement, TruthSample):
            measurements.append(measurement)
    return source.rig, measurements


def _processing_s(rig: Rig, measurements: Sequence[Measurement], seen: list[FeatureObservations]) -> float:
    """Return the processor time of filter and tracker; `seen` receives the features."""
    visual = VisualSlam(EkfSlam(default_model(), Config(), rig), seen.append)
    start_s = time.process_time()
    for measurement in measurements:
        visual.step(measurement)
    visual.finish()
    return time.process_time() - start_s
