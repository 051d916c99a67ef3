"""Watches: tests of what the calibration rests on, at every step.

calibration_watch  all of them together
scale_watch        has the scale factor changed? `drift_suspicion`: how far may it have drifted
law_watch          does the scale factor depend on the rate?
camera_watch       does the camera differ from its calibration? `camera_faults` are the errors it tests
told_faults        what they found, by the events of a run
"""
