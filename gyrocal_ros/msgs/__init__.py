"""Conversion between ROS messages and the values of `data`, shared by bags and live nodes.

topics       topic names and types; messages to values
clouds       point clouds of features and search regions
to_ros       values to messages of the recorded topics
outputs      estimates to messages of the calibrator's topics
images       image messages
transforms   quaternions, rotations and chains of frames
mounts       mounting of camera and IMU
reorder      sorts messages by stamp and detects clock steps
issues       issues of a recording, reported to a person
"""
