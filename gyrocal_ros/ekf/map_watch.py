"""Detection of a lost map: images that contradict it again and again."""

from __future__ import annotations

from collections import deque

from gyrocal_ros.data import seconds
from gyrocal_ros.ekf.equations.update import MeasurementUpdate
from gyrocal_ros.ekf.features.robust import Slip
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.ekf.noise.adaptive_noise import AdaptiveNoise
from gyrocal_ros.errors import FilterDivergedError

MAP_DROPPED = 'the images contradicted the map; a new map was started'
"""Event of a run."""
CONTRADICTED = MeasurementUpdate(rejected=3)
"""An image that contradicts the map, of which nothing is used."""
LOST_IMAGES = 15
"""Number of consecutive images that contradict the map before it is dropped."""
SOUND_IMAGES = 100
"""Number of images without an error from which a map that is bent beyond repair is dropped."""
REMEMBERED_IMAGES = 300
"""Images over which the share of those that contradict the map is averaged."""
SLIPS = (
    'the images contradict the wheels: these slip or do not turn, all that the camera sees moves, or the '
    'camera is not as its camera_info and transform say; only the position follows the images'
)
"""Event of a run."""
LIFTED = 'the robot was lifted: its position and height follow the images alone'
"""Event of a run."""
LIFTED_IMAGES = 3
"""Number of consecutive images that only a lift explains, from which it is one."""
GOES_ON_S = 0.5
"""Time since the last image that a slip explained, within which it goes on."""
SLIP_PAUSE_S = 5.0
"""Time without such images after which the next one is another event."""
CONTRADICTED_TURNS, CONTRADICTED_TURNS_S = 5, 60.0
"""Number of consecutive images that contradict a turn from which a slip is no explanation, for a time (s)."""
MANY_LOST_MAPS, MANY_LOST_MAPS_S = 4, 60.0
"""Number of maps lost within a time (s) from which the model does not fit: beams lose 2 in a minute, a
rolling shutter that the model lacks 10."""
LOSES_MAPS = 'the images contradict the map again and again'
"""Finding of such a run."""
MAX_SHARE = 0.25
"""Share of contradicting images from which the filter has diverged: below crossing beams or moving patches of
sun it is 0.2 at most."""
CHECK_THE_CAMERA = (
    'check the camera calibration, its mounting and the time stamps with `gyrocal check`; '
    'if these are right, the gyro may be at fault: see what `gyrocal diagnose` says'
)


def loses_its_map(run: Run) -> bool:
    """Return True if the map of a run was dropped more often than things that move explain."""
    lost = LostMaps()
    for event in run.events:
        if MAP_DROPPED in event.text:
            lost.add(seconds(event.t_ns - run.span.start_ns))
    return lost.are_many


class LostMaps:
    """Decides whether maps were lost too often."""

    def __init__(self) -> None:
        self.are_many = False
        """True if there ever were many within a minute."""
        self._times_s: deque[float] = deque(maxlen=MANY_LOST_MAPS)

    def add(self, time_s: float) -> None:
        """Add the loss of a map."""
        self._times_s.append(time_s)
        is_soon = abs(time_s - self._times_s[0]) < MANY_LOST_MAPS_S
        self.are_many |= len(self._times_s) == MANY_LOST_MAPS and is_soon


class SlipWatch:
    """Tells once of each time at which the images contradict the wheels: these slip, or the robot is lifted.

    It tells once of what turns with the camera, too.

    Stamps of a late camera contradict wheels and gyro in turn, so that where turns are contradicted the
    wheels are not to blame.
    """

    def __init__(self) -> None:
        self._last_ns: dict[str, int] = {}
        self._turns, self._turned_ns, self._slipped_ns = 0, -1, -1
        self._lifts = 0

    def slip(self, t_ns: int, *, drives: bool) -> Slip:
        """Return whether a slip may explain what contradicts the pose of an image.

        Args:
            t_ns: time of the image.
            drives: True if the wheels have driven the robot since the last image.
        """
        if self._turned_ns >= 0 and seconds(t_ns - self._turned_ns) <= CONTRADICTED_TURNS_S:
            return Slip.EXCLUDED
        if self._slipped_ns >= 0 and seconds(t_ns - self._slipped_ns) < GOES_ON_S:
            return Slip.GOES_ON
        return Slip.ON_FLOOR if drives else Slip.POSSIBLE

    def event(self, update: MeasurementUpdate, t_ns: int) -> str:
        """Return the event of an image; empty for none."""
        self._turns = self._turns + 1 if update.contradicts_turn else 0
        if self._turns >= CONTRADICTED_TURNS:
            self._turned_ns = t_ns
        is_lift = update.slip_std is not None and update.slip_std[2] > 0.0
        self._lifts = self._lifts + 1 if is_lift else 0
        if update.slip_std is None:
            return self._once(update.event, t_ns) if update.event else ''
        self._slipped_ns = t_ns
        return self._once(LIFTED if self._lifts >= LIFTED_IMAGES else SLIPS, t_ns)

    def _once(self, event: str, t_ns: int) -> str:
        """Return an event where it begins, and nothing while it goes on."""
        last_ns, self._last_ns[event] = self._last_ns.get(event), t_ns
        goes_on = last_ns is not None and seconds(t_ns - last_ns) < SLIP_PAUSE_S
        return '' if goes_on else event


class MapWatch:
    """Decides when the map is lost."""

    def __init__(self) -> None:
        self._contradicted = 0
        self._share = 0.0
        self._sound_images = 0

    def may_be_bent(self) -> bool:
        """Return True if images of something else may have bent the map, after many that did not.

        From the start, or again and again, the readings are at fault.
        """
        sound_images, self._sound_images = self._sound_images, 0
        return sound_images >= SOUND_IMAGES

    def is_lost(self, update: MeasurementUpdate, pixel_noise: AdaptiveNoise) -> bool:
        """Return True if the map has to be dropped after an image.

        Raises:
            FilterDivergedError: the images contradict the estimate beyond repair.
        """
        self._sound_images += 1
        if pixel_noise.is_at_limit:
            what = f'the innovations of the images exceed {pixel_noise.std:.0f} px'
            raise FilterDivergedError(what, todo=CHECK_THE_CAMERA)
        contradicts = update.rejected > 2 * update.used and update.rejected >= 3
        self._share += ((contradicts or update.freed_turn_rad != 0.0) - self._share) / REMEMBERED_IMAGES
        if self._share > MAX_SHARE:
            what = (
                f'the images contradict the estimate again and again (every {1.0 / MAX_SHARE:.0f}th of them)'
            )
            raise FilterDivergedError(what, todo=CHECK_THE_CAMERA)
        self._contradicted = self._contradicted + 1 if contradicts else 0
        if self._contradicted < LOST_IMAGES:
            return False
        self._contradicted = 0
        return True
