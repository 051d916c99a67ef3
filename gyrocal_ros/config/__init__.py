"""Settings.

sections         all settings with default, unit, bounds and description
declare          declaration, checks and output of settings
parameter_file   ROS 2 parameter files
yaml_file        YAML files in general
"""
