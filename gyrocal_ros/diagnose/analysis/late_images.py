"""A camera whose stamps are far off: the turns of the image are those of the gyro, at another time.

An image that is late by some tenths of a second contradicts the gyro in every turn. The filter then loses its
features or diverges, and a sensitivity at offset zero says nothing of it. The turns themselves show the
offset, without a map: two images show the same features, turned.
"""

from __future__ import annotations

import numpy as np

from gyrocal_ros.data import NS_PER_S, Array
from gyrocal_ros.effects import EFFECTS
from gyrocal_ros.model.recording import GyroReadings, ImageTurns, RecordingSummary
from gyrocal_ros.model.sensor import Effect, with_means

OFFSETS_S = np.arange(-200, 201) * 0.01
"""Offsets that are tried."""
MIN_OFFSET_S = 0.1
"""Least offset that is looked for; the filter finds a smaller one from its start at zero."""
AGREES = 0.01
"""Part of the mean square turn that the gyro leaves unexplained up to which the stamps are near enough."""
MAX_UNEXPLAINED = 0.1
"""Part of the mean square turn of the image that the gyro may leave unexplained at the best offset."""
MIN_GAIN = 3.0
"""Factor by which the mean square error at offset zero has to exceed that at the best offset."""
MIN_TURN_RAD = 0.3
"""Root of the sum of the squared turns of the image below which nothing can be said: about that of 60 deg."""


def late_images(recording: RecordingSummary) -> Effect | None:
    """Return the effect on the time of the images, with the offset that the turns show as its mean.

    None where the images have no large offset, or do not show one.
    """
    turns, readings = recording.image_turns, recording.readings
    if turns is None or np.linalg.norm(turns.turn_rad) < MIN_TURN_RAD or len(readings.t_ns) < 2:
        return None
    power = float(np.mean(turns.turn_rad**2))
    (at_zero,) = mean_square_errors(turns, readings, np.zeros(1))
    if at_zero < AGREES * power:
        return None
    errors = mean_square_errors(turns, readings, OFFSETS_S)
    best = int(np.argmin(errors))
    offset_s = float(OFFSETS_S[best])
    is_inside = 0 < best < len(OFFSETS_S) - 1
    explains = errors[best] < MAX_UNEXPLAINED * power
    gains = at_zero > MIN_GAIN * errors[best]
    if not (is_inside and explains and gains and abs(offset_s) > MIN_OFFSET_S):
        return None
    of_time = next(effect for effect in EFFECTS.values() if effect.acts_on == 'time')
    return with_means(of_time, (offset_s,))


def mean_square_errors(turns: ImageTurns, readings: GyroReadings, offsets_s: Array) -> Array:
    """Return the mean square (n,) of the turns of the image less those of the gyro, in rad^2.

    The scale of the gyro, and the sign by which the camera looks up or down, are fitted for each offset.

    Args:
        turns: of the image.
        readings: of the gyro.
        offsets_s: (n,) stamps of the images less true times.
    """
    start_ns = readings.t_ns[0]
    read_s, begin_s, end_s = (
        (t_ns - start_ns) / NS_PER_S for t_ns in (readings.t_ns, turns.start_ns, turns.end_ns)
    )
    rate = readings.rate_rad_s
    turned_rad = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(read_s))])
    errors = []
    for offset_s in offsets_s:
        begun, ended = (np.interp(t_s - offset_s, read_s, turned_rad) for t_s in (begin_s, end_s))
        by_gyro = ended - begun
        scale = float(by_gyro @ turns.turn_rad) / max(float(by_gyro @ by_gyro), np.finfo(float).tiny)
        errors.append(float(np.mean((turns.turn_rad - scale * by_gyro) ** 2)))
    return np.array(errors)
