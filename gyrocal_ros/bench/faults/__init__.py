"""Fault suite: damaged files and messages, wrong sensors and kills, each from a seed.

isolated     runs one case in a process of its own, with limits on time and memory
bag_bytes    bytes of the files of a bag
contents     serialised messages, and numbers in them
streams      whole topics: clocks, frames, repetitions, gaps
clouds       point clouds, camera_info, transforms and images
documents    YAML files: models, settings, calibrations, metadata
serial_line  bytes of the board
semantic     sensors that are wrong while every message is valid
kills        processes killed at random moments while they write
soak         hours through the live calibrator, with a fault every minute
suite        the cases, their outcomes and the table
"""
