"""What runs on the robot, without ROS: measurements come in as they arrive, estimates go out at once.

The nodes are shells round these; nothing here knows of messages or topics.
"""
