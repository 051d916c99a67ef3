"""The effect library.

base         explanation of an effect         library    table of contents
traits       properties for other rooms       registry   effects by name, those of the user included
checks       completeness of user effects     model_file `model.yaml`
describe     an effect in words               sketch     an effect as a picture
learned      curves, memories, maps and steps whose law is data
all others   one physical effect per file
"""

from gyrocal_ros.effects.learned import LEARNED_EFFECTS
from gyrocal_ros.effects.library import COVARIATE_EFFECTS, PAPER_EFFECTS, SCALE_FACTOR, SHIPPED
from gyrocal_ros.effects.registry import EFFECTS, default_model, find_effect

__all__ = [
    'COVARIATE_EFFECTS',
    'EFFECTS',
    'LEARNED_EFFECTS',
    'PAPER_EFFECTS',
    'SCALE_FACTOR',
    'SHIPPED',
    'default_model',
    'find_effect',
]
