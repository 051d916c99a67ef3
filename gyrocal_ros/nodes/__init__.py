"""The nodes: thin shells that turn messages into the values of `data` and back.

driver, tracker, calibrator   the robot
params, diagnostics, shell    settings as ROS parameters, health, start and end of a node

The only room that imports rclpy. All behaviour lives in `live`, `board`, `vision` and `ekf`.
"""
