"""The state of the filter.

layout             what the state holds, and where
start              its initial value: the priors, or an earlier calibration
pauses             what it is worth after a time without measurements
columns            derivatives by some coefficients, at their places among all
map, map_frame     the map as points in the world, and the errors of its frame
positive_definite  factors of covariances; `normal_equations` are solved with them
"""
