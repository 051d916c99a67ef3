"""Scenes for a camera: a ceiling, a lens, conditions and a rate, by name."""

from __future__ import annotations

from dataclasses import dataclass, replace

from gyrocal_ros.data import CameraIntrinsics
from gyrocal_ros.errors import ConfigError, did_you_mean
from gyrocal_ros.sim.image_conditions import ImageConditions
from gyrocal_ros.sim.scenarios import CAMERA, TABLES, Scenario
from gyrocal_ros.sim.scene import Furniture

PINHOLE = replace(CAMERA, distortion=(0.0,) * 5)
BARREL = replace(CAMERA, distortion=(-0.28, 0.07, 0.001, -0.001, 0.0))
"""A cheap wide-angle lens."""
RATIONAL = replace(
    CAMERA,
    fx_px=300.0,
    fy_px=300.0,
    distortion=(0.45, 0.02, 0.0005, -0.0003, 1e-4, 0.78, 0.10, 0.001),
    lens='rational_polynomial',
)
FISHEYE = replace(
    CAMERA, fx_px=285.0, fy_px=285.0, distortion=(-0.02, 0.006, -0.004, 0.0005), lens='equidistant'
)
"""A lens that sees 129 deg from left to right."""

GOOD_LIGHT = ImageConditions(exposure_s=0.004, blur_poses=2)


@dataclass(frozen=True, slots=True)
class ImageScene:
    """What the camera sees, and with what camera."""

    name: str
    about: str
    ceiling: str = 'default'
    camera: CameraIntrinsics = CAMERA
    camera_hz: int = 15
    conditions: ImageConditions = GOOD_LIGHT
    furniture: tuple[Furniture, ...] = ()

    def applied_to(self, scenario: Scenario) -> Scenario:
        """Return the scenario with the camera and the ceiling of this scene."""
        return replace(
            scenario,
            camera=self.camera,
            camera_hz=self.camera_hz,
            ceiling=self.ceiling,
            image_conditions=self.conditions,
            furniture=(*scenario.furniture, *self.furniture),
        )


SCENES: dict[str, ImageScene] = {
    scene.name: scene
    for scene in (
        ImageScene('plain', 'an office ceiling in good light'),
        ImageScene('tiles', 'tiles of one pattern', 'tiles', camera=PINHOLE),
        ImageScene('plaster', 'plaster almost without texture', 'plaster'),
        ImageScene('beams', 'beams at two depths', 'beams'),
        ImageScene('pipes', 'pipes at three depths, a barrel lens', 'pipes', camera=BARREL),
        ImageScene(
            'lamps',
            'saturated lamps that flicker at 100 Hz, a rolling shutter',
            'lamps',
            conditions=replace(GOOD_LIGHT, flicker=0.3, readout_s=0.016),
        ),
        ImageScene(
            'skylight',
            'bright windows, a patch of sun, automatic exposure',
            'skylight',
            conditions=replace(GOOD_LIGHT, auto_exposure=True, light=1.5),
        ),
        ImageScene(
            'dark',
            'low light: long exposures, gain and noise',
            conditions=ImageConditions(
                blur_poses=9, exposure_s=0.03, light=0.2, auto_exposure=True, shot_noise_grey=2.5
            ),
        ),
        ImageScene(
            'blackout',
            'the light is off for ten seconds; JPEG of quality 40',
            conditions=replace(GOOD_LIGHT, darkness_s=10.0, jpeg_quality=40),
        ),
        ImageScene('fisheye', 'a fisheye lens', camera=FISHEYE),
        ImageScene('wide', 'a wide lens with a rational distortion', camera=RATIONAL),
        ImageScene(
            'rolling',
            'a rolling shutter of 25 ms at 30 images a second',
            camera_hz=30,
            conditions=replace(GOOD_LIGHT, readout_s=0.025),
        ),
        ImageScene('slow', 'five images a second', camera_hz=5),
        ImageScene(
            'dirty',
            'dust, vignetting, a blurred lens and JPEG of quality 40',
            conditions=replace(GOOD_LIGHT, dust=25, vignetting=0.6, optical_blur_px=1.0, jpeg_quality=40),
        ),
        ImageScene(
            'aliased',
            'pixels that do not average, pipes',
            'pipes',
            camera=PINHOLE,
            conditions=replace(GOOD_LIGHT, antialiased=False),
        ),
        ImageScene(
            'lively',
            'a curtain, a fan, a person and a patch of sun move',
            conditions=replace(GOOD_LIGHT, sun_patch=True, curtain=True, fan=True, person=True),
        ),
        ImageScene('tables', 'tables that the robot drives below', furniture=TABLES),
    )
}


def find_scene(name: str) -> ImageScene:
    """Return the scene of that name.

    Raises:
        ConfigError: it does not exist.
    """
    if name not in SCENES:
        raise ConfigError(f'{name!r} is not a scene', where='scene', todo=did_you_mean(name, list(SCENES)))
    return SCENES[name]
