"""The recordings that are part of the package match their README."""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from pathlib import Path

import pytest

from gyrocal_ros.bag.source import open_bag
from gyrocal_ros.config.sections import Config

BAGS = Path(__file__).parent.parent / 'bags'
CHECKSUMS = re.findall(r'([0-9a-f]{64})  (\S+)', (BAGS / 'README.md').read_text(encoding='utf-8'))


@pytest.mark.parametrize(('checksum', 'file'), CHECKSUMS)
def test_checksum_matches_the_readme(checksum: str, file: str) -> None:
    assert hashlib.sha256((BAGS / file).read_bytes()).hexdigest() == checksum


def test_every_recorded_file_has_a_checksum() -> None:
    recorded = {file.relative_to(BAGS).as_posix() for file in BAGS.glob('*/*')}
    assert recorded == {file for _, file in CHECKSUMS}


@pytest.mark.slow
@pytest.mark.parametrize(
    ('bag', 'camera', 'images', 'duration_s', 'limit_mb'),
    [('demo', 'Frame', 750, 75.0, 20), ('cleaning', 'FeatureObservations', 4500, 300.0, 6)],
)
def test_bag_is_small_and_complete(
    bag: str, camera: str, images: int, duration_s: float, limit_mb: int
) -> None:
    assert sum(file.stat().st_size for file in (BAGS / bag).iterdir()) < limit_mb * 1e6
    source = open_bag(BAGS / bag, Config())
    assert source.span.duration_s == pytest.approx(duration_s, abs=0.1)
    counts = Counter(type(item).__name__ for item in source.measurements())
    assert counts[camera] == images
    assert counts['WheelSample'] == pytest.approx(50 * duration_s, abs=2)
    assert counts['TruthSample'] == pytest.approx(50 * duration_s, abs=2)
    assert source.warnings == []
