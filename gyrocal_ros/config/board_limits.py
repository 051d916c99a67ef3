"""Limits of the readings of the board, by the data sheets of its sensors and by the robot."""

from __future__ import annotations

from dataclasses import dataclass

from gyrocal_ros.config.declare import setting


@dataclass(frozen=True, slots=True)
class BoardLimits:
    """Largest readings; packets beyond them are damaged, whatever their checksum, and are dropped."""

    rate_deg_s: float = setting(
        2000.0, 'deg/s', 'largest rate of the gyros, at the nominal scale factor', low=1.0, high=1e5
    )
    force_m_s2: float = setting(160.0, 'm/s^2', 'largest specific force', low=10.0, high=1e4)
    speed_m_s: float = setting(5.0, 'm/s', 'largest speed by the encoders', low=0.01, high=100.0)
    turn_rate_deg_s: float = setting(1500.0, 'deg/s', 'largest turn rate by the encoders', low=1.0, high=1e5)
