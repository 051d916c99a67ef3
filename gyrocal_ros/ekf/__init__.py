"""The filter: EKF SLAM that estimates the calibration of the gyro.

slam              the algorithm: one step over a block of samples and the measurement at its end
stream            measurements become blocks and steps; `motion` buffers the samples
state, start      layout of the state; its initial value
predict           prediction of state and covariance
update            measurement updates; `image_update` for an image, `heading` for a heading reference;
                  `positive_definite` solves them
landmarks, map    features join and leave the state; the map as points in the world
known_depth       what the depth of a new feature changes as it becomes known
robust            features are judged by each other; `moving_features` and `resting_view` find those that move
gating            outlier and motion gates; `adaptive_noise`, `rest` and `map_watch` monitor the measurements
calibration_watch  tests of the scale factor, and of the camera or the heading reference
noise_bank        filters with other noise of the gyro tell how wrong the standard deviations are
effects_by_place  the effects of the sensor model in prediction and measurement
step_record, run  record of a step, and history of a run; `convergence` and `score_statistics` of it
"""
