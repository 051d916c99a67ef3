"""The filter: EKF SLAM that estimates the calibration of the gyro.

slam          the algorithm: one step over a block of samples and the measurement at its end
stream        measurements become blocks and steps; `motion` buffers the samples, `intervals` lie between them
image_update  one image; `map_watch` finds that the map is lost

The rooms; each imports only from those above it:

state         layout of the state, its initial value, the map as points; positive definite matrices
noise         noise of gyro, wheels, stamps and heading references: as set, and as learned
equations     prediction, measurement updates, heading references; the effects of the sensor model in both
features      which features to believe, how exactly, and what an image tells of their places
watches       tests of what the calibration rests on: the scale factor, the camera, the laws of the gyro
history       a step, a run and its statistics, as arrays
"""
