"""ROS messages to the values of `data` and back: the only conversion code, for bags and live nodes.

topics       topic names and types; messages become values
to_ros       values become messages of the recorded topics
outputs      estimates become messages of the calibrator's topics
images       image messages
transforms   quaternions and chains of frames
mounts       mounting of camera and IMU
reorder      sorts messages by stamp and detects clock steps
issues       problems of a recording, for a person
"""
