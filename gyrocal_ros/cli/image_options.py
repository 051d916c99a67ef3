"""Options that describe the images of a simulated robot."""

from __future__ import annotations

import argparse
from dataclasses import fields, replace

from gyrocal_ros.cli.output import warn
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.sim.ceilings import CEILINGS, find_ceiling
from gyrocal_ros.sim.image_conditions import ImageConditions, with_conditions
from gyrocal_ros.sim.image_scenes import SCENES, find_scene
from gyrocal_ros.sim.scenarios import Scenario


def add_image_options(parser: argparse.ArgumentParser) -> None:
    """Declare whether there are images, and what they show."""
    scenes = '; '.join(f'{name}: {scene.about}' for name, scene in SCENES.items())
    ceilings = '; '.join(f'{name}: {ceiling.about}' for name, ceiling in CEILINGS.items())
    conditions = ', '.join(item.name for item in fields(ImageConditions))
    parser.add_argument(
        '--images', action='store_true', help='write images of the ceiling in place of tracked features'
    )
    parser.add_argument(
        '--scene', metavar='NAME', help=f'a ceiling, a lens, conditions and a rate of the images; {scenes}'
    )
    parser.add_argument(
        '--ceiling', metavar='NAME', help=f'the ceiling, or the file of a photograph; {ceilings}'
    )
    parser.add_argument(
        '--condition',
        action='append',
        default=[],
        metavar='NAME=VALUE',
        help=f'a condition of the images: {conditions}; may be repeated',
    )
    parser.add_argument('--jpeg-quality', metavar='Q', help='deprecated: use --condition jpeg_quality=Q')


def with_image_options(args: argparse.Namespace, scenario: Scenario) -> Scenario:
    """Return the scenario with the images that the options describe.

    Raises:
        GyrocalError: an option is unknown, out of bounds, or given without `--images`.
    """
    if not args.images and (args.scene or args.ceiling or args.condition):
        raise GyrocalError(
            'are for images only', where='--scene, --ceiling, --condition', todo='add --images'
        )
    if args.scene:
        scenario = find_scene(args.scene).applied_to(scenario)
    if args.ceiling:
        find_ceiling(args.ceiling)
        scenario = replace(scenario, ceiling=args.ceiling)
    chosen = list(args.condition)
    if args.jpeg_quality is not None:
        warn('--jpeg-quality is deprecated: use --condition jpeg_quality=Q')
        chosen.insert(0, f'jpeg_quality={args.jpeg_quality}')
    conditions = with_conditions(scenario.image_conditions, chosen, '--condition')
    return replace(scenario, image_conditions=conditions)
