"""The ROS nodes: they convert messages to the values of `data` and back.

driver, tracker, calibrator   the robot
player, ceiling_emulator      a recording, an emulated camera
params, diagnostics, shell    settings as ROS parameters, health, start and end of a node

The only room that imports rclpy. All behaviour is in `robot`, `board`, `vision` and `ekf`.
"""
