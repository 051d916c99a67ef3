"""The sensor model of the paper, without the filter.

sensor       effects, coefficients and the sensor model that they form
gyro, bias   correction of the yaw rate, and the process model of the bias
kinematics   motion over a block of samples, with derivatives; `planar` has faster variants without
rotation     Euler angles
camera       projection and lens
features     feature parametrisations
recording    properties of a recording on which effects depend
"""
