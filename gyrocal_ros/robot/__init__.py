"""Runs on the robot, without ROS: measurements come in as they arrive, estimates go out at once."""
