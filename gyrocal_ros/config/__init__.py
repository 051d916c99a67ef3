"""Settings.

sections         settings of the estimator with default, unit, bounds and description
robot_sections   the same of what only the nodes need
declare          declaration, checks and output of settings
parameter_file   ROS 2 parameter files
board_limits     limits of the readings of the board
yaml_file        YAML files in general
"""
