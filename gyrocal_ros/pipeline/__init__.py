"""Settings, a sensor model and a source of measurements become a finished run and a calibration.

calibrate           calibration of a source; checks that the result is observable
run_filter          one pass of the filter over measurements
visual_slam         the filter with the feature tracker in front of it
heading_reference   calibration against a heading reference in place of the ceiling camera
in_memory           a recording in memory, its images tracked once, for several passes
calibration         the result, and `calibration.yaml`
"""
