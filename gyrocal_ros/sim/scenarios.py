"""The scenarios of the simulator, by name."""

from __future__ import annotations

from dataclasses import dataclass, field

from gyrocal_ros.data import CameraIntrinsics
from gyrocal_ros.errors import ConfigError, did_you_mean
from gyrocal_ros.sim.image_conditions import ImageConditions
from gyrocal_ros.sim.manoeuvres import DrivingStyle
from gyrocal_ros.sim.scene import Furniture
from gyrocal_ros.sim.sensors import Climate, Fan, SensorErrors
from gyrocal_ros.sim.trajectory import Leg

CAMERA = CameraIntrinsics(
    width_px=640,
    height_px=480,
    fx_px=250.0,
    fy_px=250.0,
    cx_px=319.5,
    cy_px=239.5,
    distortion=(-0.02, 0.004, 0.0005, -0.0005, 0.0),
)


@dataclass(frozen=True, slots=True)
class Scenario:
    """All parameters of a recording except its seed."""

    name: str
    about: str
    stages: tuple[tuple[str, float], ...] = (('cleaning', 0.0),)
    """Names of plans of `manoeuvres` and the time (s) until which each is followed; the last one
    continues to the end."""
    legs: tuple[Leg, ...] = ()
    """Sequence that is driven repeatedly instead of the stages."""
    duration_s: float = 300.0
    standing_s: float = 3.0
    """Rest before the first motion."""
    imu_hz: int = 200
    wheel_hz: int = 50
    camera_hz: int = 15
    truth_hz: int = 50
    features: int = 15
    """Number of features that the tracker follows at a time."""
    reacquire_s: float = 20.0
    """Maximum absence after which a feature keeps its id."""
    track_loss: float = 0.002
    """Probability of losing a visible feature in an image."""
    track_loss_s: float = 1.0
    """Mean duration of such a loss."""
    camera_until_s: float = float('inf')
    """Time at which the camera is switched off."""
    driving_style: DrivingStyle = DrivingStyle()
    errors: SensorErrors = SensorErrors()
    climate: Climate | None = None
    fan: Fan | None = None
    """Fan activity. Climate and fan are drawn at random if they are None."""
    room_m: tuple[float, float] = (6.0, 5.0)
    corners: int = 60
    """Number of corners on the ceiling."""
    furniture: tuple[Furniture, ...] = ()
    floor_tilt_deg: float = 0.15
    """Root mean square of roll and pitch on the uneven floor."""
    bumps: int = 3
    """Number of thresholds crossed."""
    camera: CameraIntrinsics = field(default=CAMERA)
    ceiling: str = 'default'
    """Name of the ceiling in the images, or file of a photograph of one."""
    image_conditions: ImageConditions = ImageConditions()
    mount_xyz_m: tuple[float, float, float] = (0.09, 0.0, 0.10)
    mount_yaw_deg: float = -90.0


TABLES = (Furniture((-1.2, 0.0), (-1.6, -0.4), 0.50, 40), Furniture((0.6, 1.9), (-1.9, -0.9), 0.75, 40))
_LANES_STYLE = DrivingStyle(turn_rates_deg_s=(75.0, 75.0), area_m=(2.8, 4.0))

SCENARIOS: dict[str, Scenario] = {
    scenario.name: scenario
    for scenario in (
        Scenario('cleaning', 'cleaning a room: lanes, sweeps, spins, turns of 30 to 90 deg/s'),
        Scenario(
            'demo',
            'a small room cleaned in little more than a minute, with many turns',
            duration_s=75.0,
            imu_hz=100,
            camera_hz=10,
            driving_style=DrivingStyle(area_m=(1.6, 1.6)),
            room_m=(3.0, 3.0),
        ),
        Scenario('filmed', 'cleaning with ten images a second', camera_hz=10),
        Scenario(
            'lanes',
            'lanes with about 40 turns at 75 deg/s',
            stages=(('lanes', 0.0),),
            imu_hz=100,
            camera_hz=10,
            driving_style=_LANES_STYLE,
        ),
        Scenario(
            'spins', 'ten rotations on the spot to one side, then to the other', stages=(('spins', 0.0),)
        ),
        Scenario('standing', 'standing still', stages=(('standing', 0.0),), duration_s=60.0),
        Scenario('rest_and_go', 'lanes with rests between them', stages=(('rest_and_go', 0.0),)),
        Scenario(
            'furniture',
            'cleaning with a bed and two tables that hide the ceiling',
            furniture=(
                Furniture((-2.6, -1.0), (-0.4, 1.2), 0.30),
                Furniture((0.6, 1.8), (-1.6, -0.9), 0.70),
                Furniture((0.4, 2.0), (0.8, 1.6), 0.45),
            ),
        ),
        Scenario(
            'tables',
            'cleaning below two tables whose undersides the camera sees',
            furniture=TABLES,
        ),
        Scenario(
            'blind_spins',
            'two minutes of lanes, then the camera is off: ten rotations to each side',
            stages=(('lanes', 120.0), ('spins', 0.0)),
            duration_s=240.0,
            driving_style=_LANES_STYLE,
            imu_hz=100,
            camera_hz=10,
            camera_until_s=120.0,
        ),
        Scenario(
            'blind_cleaning',
            'two minutes of lanes, then ten minutes of cleaning with the camera off',
            stages=(('lanes', 120.0), ('cleaning', 0.0)),
            duration_s=720.0,
            imu_hz=100,
            camera_hz=10,
            camera_until_s=120.0,
        ),
    )
}


def find_scenario(name: str) -> Scenario:
    """Return the scenario of that name.

    Raises:
        ConfigError: it does not exist.
    """
    if name not in SCENARIOS:
        raise ConfigError(
            f'{name!r} is not a scenario', where='scenario', todo=did_you_mean(name, list(SCENARIOS))
        )
    return SCENARIOS[name]
