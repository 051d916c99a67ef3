"""Finds what is wrong with a sensor in the events of a run, by the first words of what the tests tell."""

from gyrocal_ros.ekf.features.knock_watch import KNOCKED
from gyrocal_ros.ekf.features.way_agreement import WRONG_YAW
from gyrocal_ros.ekf.watches.camera_faults import CENTRE, LENS, SHUTTER, TILT, TIME
from gyrocal_ros.ekf.watches.law_watch import RATES, SIDES

FIRST_WORDS = LENS, TILT, CENTRE, SHUTTER, TIME, RATES, SIDES, WRONG_YAW, KNOCKED


def told_fault(event: str) -> tuple[str, str]:
    """Return the fault and the remedy of a finding in the text of an event, which may report others as well.

    Both are empty where there is none.
    """
    starts = [event.find(first_words) for first_words in FIRST_WORDS]
    found = [start for start in starts if start >= 0]
    if not found:
        return '', ''
    fault, remedy, *_ = event[min(found) :].split('; ')
    return fault, remedy
