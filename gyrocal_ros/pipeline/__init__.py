"""Settings, a sensor model and a source of measurements become a finished run and a calibration.

calibrate           one pass of the filter over a source
visual_slam         the filter with the feature tracker in front of it
heading_reference   calibration against a heading reference in place of the ceiling camera
calibration         the result, and `calibration.yaml`
"""
