# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Twins of `model.gyro` and `ekf.equations.predict`, with what that is made of: `model.kinematics` and `ekf.noise.process_noise`. They
explain the equations."""

from libc.math cimport cos, fabs, sin, sqrt, tan
from libc.string cimport memcpy

cimport numpy as cnp
from numpy cimport ndarray as Array

from gyrocal_ros.kernels.arrays cimport at, clear, copied, cube, doubles, length, matrix, vector
from gyrocal_ros.kernels.rotations cimport rotate

cnp.import_array()

TWINS = ('carry', 'corrected_rates')


cdef class Motion:
    """Motion in a block of N intervals, the fields of `PoseStep` in their order."""

    cdef Array position, euler, transition, rate_gain, forward, mid, pose_rate

    def __cinit__(self, Py_ssize_t n):
        self.position, self.euler, self.transition, self.rate_gain = vector(3), vector(3), matrix(6, 6), cube(6, 3, n)
        self.forward, self.mid, self.pose_rate = matrix(3, n), matrix(3, n), vector(6)


cdef Motion carry_pose(
    const double* position_m,
    const double* euler_rad,
    const double* rate_rad_s,
    const double* dt_s,
    const double* distance_m,
    Py_ssize_t n,
):
    """Twin of `integrate`."""
    cdef Py_ssize_t i, j, k, l
    cdef Motion motion = Motion(n)
    cdef double* position = at(motion.position)
    cdef double* euler = at(motion.euler)
    cdef double* pose_rate = at(motion.pose_rate)
    cdef double* transition = at(motion.transition)
    cdef double* forward = at(motion.forward)
    cdef double* mid = at(motion.mid)
    cdef double* rate_gain = at(motion.rate_gain)
    # Derivatives by the Euler angles, (6, 3) for each interval: rows 0 to 2 of the steps, 3 to 5 of the increments.
    cdef Array work = matrix(n, 22)
    cdef double* step
    cdef double* trig
    cdef double total[6][3]
    cdef double before[6][3]
    cdef double after[6][3]
    cdef double drift[3][3]
    cdef double squared[3][3]
    cdef double increment[3]
    cdef double end[3]
    cdef double E[3][3]
    cdef double turned = 0.0, tilted_re = 0.0, tilted_im = 0.0
    cdef double tx, ty, tz, heading, c, s, re, im, roll, pitch, sr, cr, sp, cp, sy, cy, tp, secant, level, across, d

    for i in range(6):
        for j in range(3):
            total[i][j] = 0.0
    for i in range(3):
        end[i] = 0.0
        position[i] = position_m[i]

    for k in range(n):
        step = at(work) + 22 * k
        trig = step + 18
        clear(step, 18)
        tx, ty, tz = rate_rad_s[3 * k] * dt_s[k], rate_rad_s[3 * k + 1] * dt_s[k], rate_rad_s[3 * k + 2] * dt_s[k]
        # First guess of the angles in the middle: z = roll + i pitch turns with the heading.
        turned += tz
        heading = turned - 0.5 * tz
        c, s = cos(heading), sin(heading)
        re, im = tx * c - ty * s, tx * s + ty * c
        tilted_re += re
        tilted_im += im
        re = euler_rad[0] + tilted_re - 0.5 * re
        im = euler_rad[1] + tilted_im - 0.5 * im
        roll, pitch = re * c + im * s, im * c - re * s

        sr, cr, tp = sin(roll), cos(roll), tan(pitch)
        level = sr * ty + cr * tz
        increment[0] = tx + tp * level
        increment[1] = cr * ty - sr * tz
        increment[2] = level * sqrt(1.0 + tp * tp)
        for i in range(3):
            end[i] += increment[i]
            mid[i * n + k] = euler_rad[i] + end[i] - 0.5 * increment[i]

        sr, cr = sin(mid[k]), cos(mid[k])
        sp, cp = sin(mid[n + k]), cos(mid[n + k])
        sy, cy = sin(mid[2 * n + k]), cos(mid[2 * n + k])
        d = distance_m[k]
        forward[k], forward[n + k], forward[2 * n + k] = cy * cp, sy * cp, -sp
        for i in range(3):
            position[i] += forward[i * n + k] * d
        step[1], step[2] = -cy * sp * d, -sy * cp * d
        step[4], step[5] = -sy * sp * d, cy * cp * d
        step[7] = -cp * d
        secant = 1.0 / cp
        trig[0], trig[1], trig[2], trig[3] = sr, cr, sp, secant
        tp = sp * secant
        level = sr * ty + cr * tz
        across = cr * ty - sr * tz
        step[9], step[10] = tp * across, level * secant * secant
        step[12] = -level
        step[15], step[16] = across * secant, level * tp * secant
        for i in range(6):
            for j in range(3):
                total[i][j] += step[3 * i + j]

    for i in range(36):
        transition[i] = 1.0 if i % 7 == 0 else 0.0
    for i in range(3):
        euler[i] = euler_rad[i] + end[i]
        pose_rate[i] = forward[i * n + n - 1] * distance_m[n - 1] / dt_s[n - 1]
        pose_rate[3 + i] = increment[i] / dt_s[n - 1]
        for j in range(3):
            drift[i][j] = total[3 + i][j]
    for i in range(3):
        for j in range(3):
            squared[i][j] = 0.0
            for l in range(3):
                squared[i][j] += drift[i][l] * drift[l][j]
    for i in range(3):
        for j in range(3):
            transition[(3 + i) * 6 + 3 + j] += drift[i][j] + squared[i][j] / 2.0
            for l in range(3):
                transition[(3 + i) * 6 + 3 + j] += squared[i][l] * drift[l][j] / 6.0
            transition[i * 6 + 3 + j] = total[i][j]

    for i in range(6):
        for j in range(3):
            before[i][j] = 0.0
    for i in range(3):
        for j in range(3):
            E[i][j] = 0.0
    E[0][0] = 1.0
    for k in range(n):
        step = at(work) + 22 * k
        trig = step + 18
        for i in range(6):
            for j in range(3):
                d = before[i][j] + 0.5 * step[3 * i + j]  # up to the middle of the interval
                after[i][j] = total[i][j] - d
                before[i][j] += step[3 * i + j]
        for i in range(3):
            for j in range(3):
                for l in range(3):
                    transition[i * 6 + 3 + j] += step[3 * i + l] * (before[3 + l][j] - 0.5 * step[9 + 3 * l + j])
            after[3 + i][i] += 1.0
        sr, cr, sp, secant = trig[0], trig[1], trig[2], trig[3]
        E[1][1], E[1][2] = cr, -sr
        E[2][1], E[2][2] = sr * secant, cr * secant
        E[0][1], E[0][2] = E[2][1] * sp, E[2][2] * sp
        for i in range(6):
            for j in range(3):
                d = 0.0
                for l in range(3):
                    d += after[i][l] * E[l][j]
                rate_gain[(3 * i + j) * n + k] = d * dt_s[k]
    return motion


cdef int add_process_noise(
    noise, Motion motion, const double* dt_s, const double* rate_rad_s, const double* distance_m, Py_ssize_t n, double* P,
    Py_ssize_t width
) except -1:
    """Add the twin of `process_noise` to the robot part (r, r) of a covariance (width, width)."""
    cdef Py_ssize_t i, j, k, l
    cdef double along, across, up, turning, gap_rad = noise.gap_rad, unknown_rad = noise.unknown_rad
    cdef double wheel_gap_m = noise.wheel_gap_m, duration_s = noise.duration_s, walk
    cdef double way_m = 0.0, turn_rad = 0.0, weight, floor
    cdef double R[3][3]
    cdef double euler[3]
    cdef double step[3]
    cdef double density[3]
    cdef double added[6][6]
    cdef Array of_tilt = doubles(noise.tilt_density_rad_s), of_yaw = None, walks = doubles(noise.walks)
    cdef const double* rate_gain = at(motion.rate_gain)
    along, across, up, turning = noise.wheels
    density[0], density[1] = at(of_tilt)[0], at(of_tilt)[1]
    if isinstance(noise.yaw_density_rad_s, float):
        density[2] = noise.yaw_density_rad_s
    else:
        of_yaw = doubles(noise.yaw_density_rad_s)
    for i in range(6):
        for j in range(6):
            added[i][j] = 0.0
    for k in range(n):
        way_m += fabs(distance_m[k])
        turn_rad += fabs(rate_rad_s[3 * k + 2]) * dt_s[k]
        if of_yaw is not None:
            density[2] = at(of_yaw)[k]
        for l in range(3):
            weight = density[l] * density[l] / dt_s[k]
            for i in range(6):
                for j in range(i + 1):
                    added[i][j] += rate_gain[(3 * i + l) * n + k] * rate_gain[(3 * j + l) * n + k] * weight
    for i in range(3):
        euler[i] = at(motion.mid)[i * n + n // 2]
    rotate(euler, R)
    floor = turning * turning * turn_rad + wheel_gap_m * wheel_gap_m
    step[0], step[1], step[2] = way_m * along * along + floor, way_m * across * across + floor, way_m * up * up
    for i in range(3):
        added[3 + i][3 + i] += gap_rad * gap_rad
        for j in range(i + 1):
            for l in range(3):
                added[i][j] += R[i][l] * step[l] * R[j][l]
    added[5][5] += unknown_rad * unknown_rad
    for i in range(6):
        P[i * width + i] += added[i][i]
        for j in range(i):
            P[i * width + j] += added[i][j]
            P[j * width + i] = P[i * width + j]
    walk = noise.tilt_walk_rad_s
    P[6 * (width + 1)] += walk * walk * duration_s
    P[7 * (width + 1)] += walk * walk * duration_s
    walk = noise.yaw_walk_rad_s
    P[8 * (width + 1)] += walk * walk * duration_s
    for i in range(length(walks)):
        P[(9 + i) * (width + 1)] += at(walks)[i] * at(walks)[i] * duration_s
    return 0


def carry(state, block, rate_rad_s, added, noise, double bias_rad_s, double bias_kept):
    cdef Array mean = doubles(state.mean), dt_s = doubles(block.dt_s), by_wheels_m = doubles(block.distance_m)
    cdef Array readings = doubles(block.rate_rad_s), rates = doubles(rate_rad_s), distance_m = by_wheels_m
    cdef Array by_values = doubles(added.correction.by_values), valid = None, more
    cdef Py_ssize_t n = length(dt_s), k = length(by_values, 1), r = 9 + k, i, j, l
    cdef double valid_everywhere = 1.0
    if not isinstance(added.distance_m, float):
        distance_m = doubles(block.distance_m + added.distance_m)
    if isinstance(added.correction.valid, float):
        valid_everywhere = added.correction.valid
    else:
        valid = doubles(added.correction.valid)
    cdef Motion motion = carry_pose(at(mean), at(mean) + 3, at(rates), at(dt_s), at(distance_m), n)
    cdef Array gain = matrix(6, n), transition = matrix(r, r), covariance, sensitivity
    cdef double* yaw_gain = at(gain)
    cdef double* F = at(transition)
    cdef const double* rate_gain = at(motion.rate_gain)
    clear(F, r * r)
    for i in range(6):
        for j in range(6):
            F[i * r + j] = at(motion.transition)[6 * i + j]
        for l in range(n):
            yaw_gain[i * n + l] = rate_gain[(3 * i + 2) * n + l] * (valid_everywhere if valid is None else at(valid)[l])
            F[i * r + 6] += rate_gain[3 * i * n + l]
            F[i * r + 7] += rate_gain[(3 * i + 1) * n + l]
            F[i * r + 8] += yaw_gain[i * n + l]
            for j in range(k):
                F[i * r + 9 + j] += yaw_gain[i * n + l] * at(by_values)[l * k + j]
    for i in range(6, r):
        F[i * r + i] = 1.0
    F[8 * r + 8] = bias_kept
    if added.distance_by_values is not None:
        more = doubles(added.distance_by_values)
        for i in range(3):
            for l in range(n):
                for j in range(k):
                    F[i * r + 9 + j] += at(motion.forward)[i * n + l] * at(more)[l * k + j]
    if added.drift_by_values is not None:
        more = doubles(added.drift_by_values)
        for i in range(3):
            for j in range(k):
                F[i * r + 9 + j] += at(more)[i * k + j]
    covariance, sensitivity = carry_covariance(doubles(state.covariance), doubles(state.sensitivity), transition)
    add_process_noise(noise, motion, at(dt_s), at(readings), at(by_wheels_m), n, at(covariance), length(covariance))
    cdef Array after = copied(mean)
    for i in range(3):
        at(after)[i], at(after)[3 + i] = at(motion.position)[i], at(motion.euler)[i]
    if not isinstance(added.drift_m, float):
        more = doubles(added.drift_m)
        for i in range(3):
            at(after)[i] += at(more)[i]
    at(after)[8] = bias_rad_s
    return (
        after, covariance, sensitivity, transition, gain, motion.position, motion.euler, motion.transition,
        motion.rate_gain, motion.forward, motion.mid, motion.pose_rate
    )


def corrected_rates(rate_rad_s, correction_rad_s, valid, bias_rad_s):
    cdef Array readings = doubles(rate_rad_s), correction = doubles(correction_rad_s), biases = doubles(bias_rad_s)
    cdef Array acts = None if isinstance(valid, float) else doubles(valid)
    cdef Py_ssize_t n = length(readings), k
    cdef const double* bias = at(biases)
    cdef double yaw_bias = bias[2] * (valid if acts is None else 1.0)
    cdef Array rate = matrix(n, 3)
    for k in range(n):
        at(rate)[3 * k] = at(readings)[3 * k] + bias[0]
        at(rate)[3 * k + 1] = at(readings)[3 * k + 1] + bias[1]
        at(rate)[3 * k + 2] = (
            at(readings)[3 * k + 2] + at(correction)[k] + yaw_bias * (1.0 if acts is None else at(acts)[k])
        )
    return rate


cdef tuple carry_covariance(Array covariance, Array sensitivity, Array transition):
    """Twin of the same name, without noise."""
    cdef Py_ssize_t n = length(covariance), r = length(transition), c = length(sensitivity, 1), i, j, l
    cdef Array after = matrix(n, n), carried = copied(sensitivity), products = matrix(r, n)
    cdef const double* F = at(transition)
    cdef const double* source
    cdef double* row
    cdef double* P = at(after)
    cdef double factor
    clear(at(products), r * n)
    for i in range(r):
        row = at(products) + i * n
        for l in range(r):
            factor, source = F[i * r + l], at(covariance) + l * n
            if factor != 0.0:
                for j in range(n):
                    row[j] += factor * source[j]
        for j in range(r, n):
            P[i * n + j] = P[j * n + i] = row[j]
        for j in range(i + 1):
            factor = 0.0
            for l in range(r):
                factor += row[l] * F[j * r + l]
            P[i * n + j] = P[j * n + i] = factor
    for i in range(r, n):
        memcpy(P + i * n + r, at(covariance) + i * n + r, (n - r) * sizeof(double))
    clear(at(carried), r * c)
    for i in range(r):
        row = at(carried) + i * c
        for l in range(r):
            factor, source = F[i * r + l], at(sensitivity) + l * c
            if factor != 0.0:
                for j in range(c):
                    row[j] += factor * source[j]
    return after, carried
