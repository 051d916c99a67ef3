"""Settings.

sections         every setting: default, unit, bounds, meaning
declare          how settings are declared, checked and written
parameter_file   ROS 2 parameter files
yaml_file        YAML files in general
"""
