"""The effect library.

base         what an effect explains          library    table of contents
traits       what other rooms ask of it       registry   effects by name, those of the user included
checks       completeness of user effects     model_file `model.yaml`
describe     an effect in words               sketch     an effect as a picture
all others   one physical effect a file
"""

from gyrocal_ros.effects.library import COVARIATE_EFFECTS, PAPER_EFFECTS, SCALE_FACTOR, SHIPPED
from gyrocal_ros.effects.registry import EFFECTS, default_model, find_effect

__all__ = [
    'COVARIATE_EFFECTS',
    'EFFECTS',
    'PAPER_EFFECTS',
    'SCALE_FACTOR',
    'SHIPPED',
    'default_model',
    'find_effect',
]
