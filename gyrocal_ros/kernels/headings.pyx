# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Twin of `diagnose.analysis.heading_filter`, which explains the equations."""

from libc.math cimport INFINITY, isinf, isnan

import numpy as np

TWINS = ('compare_headings',)


def compare_headings(
    const double[:] measured_rad,
    const double[:] noise,
    const double[:] gyro_valid_s,
    const double[:] away_walk,
    double bias_variance,
    const double[:] bias_walk,
    double outlier_sigma,
    const double[:, :] added_rad,
):
    cdef Py_ssize_t steps = added_rad.shape[0], count = added_rad.shape[1], t, i
    arrays = (np.zeros((steps, count)), np.zeros(steps), np.ones(steps))
    cdef double[:, ::1] sensitivities = arrays[0]
    cdef double[::1] innovations = arrays[1], variances = arrays[2]
    cdef double[::1] x_away = np.zeros(count), x_bias = np.zeros(count)
    cdef double away = 0.0, bias = 0.0, p_away = INFINITY, p_both = 0.0, p_bias = bias_variance
    cdef double valid_s, innovation, variance, outlying, gain_away, gain_bias
    for t in range(steps):
        valid_s = gyro_valid_s[t]
        away += bias * valid_s
        for i in range(count):
            x_away[i] += x_bias[i] * valid_s + added_rad[t, i]
        p_away += (2.0 * p_both + p_bias * valid_s) * valid_s + away_walk[t]
        p_both += p_bias * valid_s
        p_bias += bias_walk[t]
        if isnan(measured_rad[t]):
            continue
        if isinf(p_away):
            away, p_away, p_both = measured_rad[t], noise[t], 0.0
            for i in range(count):
                x_away[i] = 0.0
            continue
        innovation = measured_rad[t] - away
        outlying = innovation / outlier_sigma
        variance = max(p_away + noise[t], outlying * outlying)
        innovations[t], variances[t] = innovation, variance
        gain_away, gain_bias = p_away / variance, p_both / variance
        away += gain_away * innovation
        bias += gain_bias * innovation
        for i in range(count):
            sensitivities[t, i] = x_away[i]
            x_bias[i] -= gain_bias * x_away[i]
            x_away[i] *= 1.0 - gain_away
        p_bias -= gain_bias * p_both
        p_both -= gain_away * p_both
        p_away -= gain_away * p_away
    return arrays
