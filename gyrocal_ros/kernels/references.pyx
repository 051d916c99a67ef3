# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Twin of `ekf.noise.reference_bank`, which with `ekf.noise.reference_noise` explains the equations."""

from libc.math cimport fabs, log, log1p, sqrt

import numpy as np

TWINS = ('filter_headings',)

cdef enum:
    HEADING
    BIAS
    SCALE
    OFFSET

cdef double OUTLIER_SIGMA = 5.0
cdef double STAYS_SIGMA = 2.5
cdef long JUMP_HEADINGS = 4
cdef double JUMP_S = 1.0
cdef double JUMP_LOG_PRIOR = -7.0


def filter_headings(
    mean, covariance, log_likelihood, outlying, outliers, side, since_s,
    noise, double bias_walk, double gap_rate_rad_s, const double[:, :] headings,
):
    cdef Py_ssize_t n = headings.shape[0], m = len(mean), t, a, i, j
    cdef double dt, turn, gap, rate, added, variance, residual, deviation, new_side, distance, gain
    cdef double noise_variance, slope, pull, rest, rest_turn, moving, moving_turn
    cdef double numerator[4]
    cdef double* x
    cdef double* C
    cdef bint goes_on, may_have, has, still
    state = (
        np.array(mean), np.array(covariance), np.array(log_likelihood), np.array(outlying),
        np.array(outliers), np.array(side), np.array(since_s),
    )
    cdef double[:, ::1] X = state[0]
    cdef double[:, :, ::1] P = state[1]
    cdef double[::1] likelihood = state[2], pending = state[3], sides = state[5], since = state[6]
    cdef long[::1] counts = state[4]
    cdef const double[:] white = noise.white_rad, walk = noise.walk_rad, dof = noise.tail_dof
    cdef const double[:] stamp = noise.stamp_s, constant = noise.log_constant
    cdef const double[:] wider = noise.wider
    jumped = np.zeros((n, m), bool)
    cdef unsigned char[:, ::1] has_jumped = jumped.view(np.uint8)
    for a in range(m):
        x, C = &X[a, 0], &P[a, 0, 0]
        for t in range(n):
            dt, turn, gap, rate = headings[t, 0], headings[t, 1], headings[t, 2], headings[t, 3]
            rest, rest_turn, still = headings[t, 5], headings[t, 6], False
            if rest > 0.0:
                for i in range(4):
                    numerator[i] = rest * C[4 * BIAS + i] + rest_turn * C[4 * SCALE + i]
                variance = rest * numerator[BIAS] + rest_turn * numerator[SCALE] + headings[t, 7] * headings[t, 7]
                residual = -(rest_turn + rest * x[BIAS] + rest_turn * x[SCALE])
                distance = residual * residual / variance
                still = distance <= OUTLIER_SIGMA * OUTLIER_SIGMA
                likelihood[a] -= 0.5 * (log(variance) + min(distance, OUTLIER_SIGMA * OUTLIER_SIGMA))
                if still:
                    for i in range(4):
                        gain = numerator[i] * (1.0 / variance)
                        x[i] += gain * residual
                        for j in range(4):
                            C[4 * i + j] -= gain * numerator[j]
            moving, moving_turn = dt, turn
            if still:
                moving, moving_turn = dt - rest, turn - rest_turn
                x[HEADING] -= rest_turn
            x[HEADING] += moving * x[BIAS] + moving_turn * x[SCALE]
            for i in range(4):
                C[i] += moving * C[4 * BIAS + i] + moving_turn * C[4 * SCALE + i]
            for i in range(4):
                C[4 * i] += moving * C[4 * i + BIAS] + moving_turn * C[4 * i + SCALE]
            C[0] += walk[a] * walk[a] * dt + gap_rate_rad_s * gap * (gap_rate_rad_s * gap)
            C[5 * BIAS] += bias_walk * dt

            for i in range(4):
                numerator[i] = C[i] - rate * C[4 * OFFSET + i]
            noise_variance = white[a] * white[a] + stamp[a] * stamp[a] * (rate * rate)
            variance = numerator[HEADING] - rate * numerator[OFFSET] + noise_variance
            residual = headings[t, 4] - x[HEADING] + rate * x[OFFSET]

            deviation = residual / sqrt(variance)
            goes_on = deviation * sides[a] > STAYS_SIGMA
            if goes_on:
                counts[a] += 1
                since[a] += dt
            else:
                new_side = 0.0 if not fabs(deviation) > OUTLIER_SIGMA else 1.0 if deviation > 0.0 else -1.0
                counts[a], since[a], sides[a] = new_side != 0.0, 0.0, new_side
            may_have = counts[a] >= JUMP_HEADINGS
            has = may_have and since[a] >= JUMP_S
            if has:
                has_jumped[t, a] = True
                counts[a], sides[a], may_have = 0, 0.0, False
                added = residual * residual
                C[0] += added
                numerator[HEADING] += added
                variance += added
                pending[a] = JUMP_LOG_PRIOR

            distance = residual * residual / variance
            pending[a] += constant[a] - 0.5 * (log(variance) + (dof[a] + 1.0) * log1p(wider[a] * distance / dof[a]))
            if counts[a] == 0:
                likelihood[a] += pending[a]
                pending[a] = 0.0

            if may_have:
                continue
            slope = (dof[a] + 3.0) / (dof[a] + wider[a] * distance)
            pull = slope if slope < 1.0 else 1.0 + noise_variance / variance * (slope - 1.0)
            for i in range(4):
                gain = numerator[i] * (1.0 / variance)
                x[i] += gain * (pull * residual)
                for j in range(4):
                    C[4 * i + j] -= gain * min(slope, 1.0) * numerator[j]
    return (*state, jumped)
