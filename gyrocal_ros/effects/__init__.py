"""The effect library: one physical effect a file, and this table of contents.

`model.yaml` names effects of this table; see `model_file` for reading and writing it.
"""

from __future__ import annotations

import re

from gyrocal_ros.config import nearest
from gyrocal_ros.effects.bias_warmup import BiasWarmup
from gyrocal_ros.effects.scale import scale_power
from gyrocal_ros.errors import ConfigError
from gyrocal_ros.model.gyro import BiasModel, GyroTerm, SensorModel

EFFECTS: dict[str, GyroTerm] = {
    term.name: term for term in (scale_power(1), scale_power(2), scale_power(3), BiasWarmup())
}


def find_effect(name: str, where: str = '') -> GyroTerm:
    """The effect of that name with its usual priors.

    Args:
        name: a name of the table, or `scale_power_N` for a power above the third.
        where: file that names it, for the error message.

    Raises:
        ConfigError: there is no such effect.
    """
    if name in EFFECTS:
        return EFFECTS[name]
    power = re.fullmatch(r'scale_power_([4-9])', name)
    if power:
        return scale_power(int(power.group(1)))
    raise ConfigError(
        f'there is no effect {name!r}', where=where, todo=nearest(name, [*EFFECTS, 'scale_power_4'])
    )


def default_model() -> SensorModel:
    """The model that a robot starts with: one scale factor, and a bias that drifts."""
    return SensorModel('default', BiasModel(), (find_effect('scale_factor'),))
