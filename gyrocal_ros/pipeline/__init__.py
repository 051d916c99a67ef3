"""Settings, a sensor model and a source of measurements become a finished run and a calibration.

calibrate           calibration of a source; checks that the result is observable
run_filter          one pass of the filter over measurements
visual_slam         the filter with the feature tracker in front of it
by_heading          calibration against a heading reference in place of the ceiling camera
heading_reference   fit of such a reference to the gyro: its time offset and its noise
in_memory           a recording in memory, its images tracked or its reference fitted once, for several passes
calibration         the result, and `calibration.yaml`
"""
