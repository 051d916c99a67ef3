# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Twins of `model.rotation`, `model.gyro`, `model.features.base` and `ekf.predict`, with what that is made of:
`model.kinematics` and `ekf.process_noise`. They explain the equations."""

from libc.math cimport cos, fabs, sin, sqrt, tan

import numpy as np

TWINS = (
    'carry',
    'corrected_rates',
    'rotation_derivatives',
    'rotation_from_euler',
    'turned_camera',
)


cdef class Motion:
    """Motion in a block of N intervals, the fields of `PoseStep` in their order."""

    cdef tuple arrays
    cdef double[::1] position, euler, pose_rate
    cdef double[:, ::1] transition, forward, mid
    cdef double[:, :, ::1] rate_gain

    def __cinit__(self, Py_ssize_t n):
        self.arrays = (
            np.empty(3), np.empty(3), np.eye(6), np.empty((6, 3, n)), np.empty((3, n)), np.empty((3, n)), np.empty(6)
        )
        self.position, self.euler, self.transition, self.rate_gain, self.forward, self.mid, self.pose_rate = self.arrays


cdef Motion carry_pose(
    const double[:] position_m,
    const double[:] euler_rad,
    const double[:, :] rate_rad_s,
    const double[:] dt_s,
    const double[:] distance_m,
):
    """Twin of `integrate`."""
    cdef Py_ssize_t n = dt_s.shape[0], i, j, k, l
    cdef Motion motion = Motion(n)
    cdef double[::1] position = motion.position, euler = motion.euler, pose_rate = motion.pose_rate
    cdef double[:, ::1] transition = motion.transition, forward = motion.forward, mid = motion.mid
    cdef double[:, :, ::1] rate_gain = motion.rate_gain
    # Derivatives by the Euler angles, (6, 3) for each interval: rows 0 to 2 of the steps, 3 to 5 of the increments.
    cdef double[:, :, ::1] by_euler = np.zeros((n, 6, 3))
    cdef double[:, ::1] trig = np.empty((n, 4))
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
        tx, ty, tz = rate_rad_s[k, 0] * dt_s[k], rate_rad_s[k, 1] * dt_s[k], rate_rad_s[k, 2] * dt_s[k]
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
            mid[i, k] = euler_rad[i] + end[i] - 0.5 * increment[i]

        sr, cr = sin(mid[0, k]), cos(mid[0, k])
        sp, cp = sin(mid[1, k]), cos(mid[1, k])
        sy, cy = sin(mid[2, k]), cos(mid[2, k])
        d = distance_m[k]
        forward[0, k], forward[1, k], forward[2, k] = cy * cp, sy * cp, -sp
        for i in range(3):
            position[i] += forward[i, k] * d
        by_euler[k, 0, 1], by_euler[k, 0, 2] = -cy * sp * d, -sy * cp * d
        by_euler[k, 1, 1], by_euler[k, 1, 2] = -sy * sp * d, cy * cp * d
        by_euler[k, 2, 1] = -cp * d
        secant = 1.0 / cp
        trig[k, 0], trig[k, 1], trig[k, 2], trig[k, 3] = sr, cr, sp, secant
        tp = sp * secant
        level = sr * ty + cr * tz
        across = cr * ty - sr * tz
        by_euler[k, 3, 0], by_euler[k, 3, 1] = tp * across, level * secant * secant
        by_euler[k, 4, 0] = -level
        by_euler[k, 5, 0], by_euler[k, 5, 1] = across * secant, level * tp * secant
        for i in range(6):
            for j in range(3):
                total[i][j] += by_euler[k, i, j]

    for i in range(3):
        euler[i] = euler_rad[i] + end[i]
        pose_rate[i] = forward[i, n - 1] * distance_m[n - 1] / dt_s[n - 1]
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
            transition[3 + i, 3 + j] += drift[i][j] + squared[i][j] / 2.0
            for l in range(3):
                transition[3 + i, 3 + j] += squared[i][l] * drift[l][j] / 6.0
            transition[i, 3 + j] = total[i][j]

    for i in range(6):
        for j in range(3):
            before[i][j] = 0.0
    for i in range(3):
        for j in range(3):
            E[i][j] = 0.0
    E[0][0] = 1.0
    for k in range(n):
        for i in range(6):
            for j in range(3):
                d = before[i][j] + 0.5 * by_euler[k, i, j]  # up to the middle of the interval
                after[i][j] = total[i][j] - d
                before[i][j] += by_euler[k, i, j]
        for i in range(3):
            for j in range(3):
                for l in range(3):
                    transition[i, 3 + j] += by_euler[k, i, l] * (before[3 + l][j] - 0.5 * by_euler[k, 3 + l, j])
            after[3 + i][i] += 1.0
        sr, cr, sp, secant = trig[k, 0], trig[k, 1], trig[k, 2], trig[k, 3]
        E[1][1], E[1][2] = cr, -sr
        E[2][1], E[2][2] = sr * secant, cr * secant
        E[0][1], E[0][2] = E[2][1] * sp, E[2][2] * sp
        for i in range(6):
            for j in range(3):
                d = 0.0
                for l in range(3):
                    d += after[i][l] * E[l][j]
                rate_gain[i, j, k] = d * dt_s[k]
    return motion


cdef void add_process_noise(
    noise, Motion motion, const double[:] dt_s, const double[:, :] rate_rad_s, const double[:] distance_m, double[:, ::1] P
):
    """Add the twin of `process_noise` to the robot part (r, r) of a covariance."""
    cdef Py_ssize_t n = dt_s.shape[0], i, j, k, l
    cdef double along, across, up, turning, gap_rad = noise.gap_rad, unknown_rad = noise.unknown_rad
    cdef double wheel_gap_m = noise.wheel_gap_m, duration_s = noise.duration_s, walk
    cdef double way_m = 0.0, turn_rad = 0.0, weight, floor
    cdef double R[3][3]
    cdef double euler[3]
    cdef double step[3]
    cdef double density[3]
    cdef double added[6][6]
    cdef const double[:] of_tilt = None, of_yaw = None, walks = noise.walks
    cdef double[:, :, ::1] rate_gain = motion.rate_gain
    along, across, up, turning = noise.wheels
    if isinstance(noise.tilt_density_rad_s, float):
        density[0] = density[1] = noise.tilt_density_rad_s
    else:
        of_tilt = noise.tilt_density_rad_s
        density[0], density[1] = of_tilt[0], of_tilt[1]
    if isinstance(noise.yaw_density_rad_s, float):
        density[2] = noise.yaw_density_rad_s
    else:
        of_yaw = noise.yaw_density_rad_s
    for i in range(6):
        for j in range(6):
            added[i][j] = 0.0
    for k in range(n):
        way_m += fabs(distance_m[k])
        turn_rad += fabs(rate_rad_s[k, 2]) * dt_s[k]
        if of_yaw is not None:
            density[2] = of_yaw[k]
        for l in range(3):
            weight = density[l] * density[l] / dt_s[k]
            for i in range(6):
                for j in range(i + 1):
                    added[i][j] += rate_gain[i, l, k] * rate_gain[j, l, k] * weight
    for i in range(3):
        euler[i] = motion.mid[i, n // 2]
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
        P[i, i] += added[i][i]
        for j in range(i):
            P[i, j] += added[i][j]
            P[j, i] = P[i, j]
    walk = noise.tilt_walk_rad_s
    P[6, 6] += walk * walk * duration_s
    P[7, 7] += walk * walk * duration_s
    walk = noise.yaw_walk_rad_s
    P[8, 8] += walk * walk * duration_s
    for i in range(walks.shape[0]):
        P[9 + i, 9 + i] += walks[i] * walks[i] * duration_s


def carry(state, block, const double[:, :] rate_rad_s, added, noise, double bias_rad_s, double bias_kept):
    cdef const double[::1] mean = state.mean
    cdef const double[:] dt_s = block.dt_s, by_wheels_m = block.distance_m, distance_m = by_wheels_m
    cdef const double[:] valid = None, drift_m = None
    cdef const double[:, :] by_values = added.correction.by_values, more
    cdef Py_ssize_t n = dt_s.shape[0], k = by_values.shape[1], r = 9 + k, i, j, l
    cdef double valid_everywhere = 1.0
    if not isinstance(added.distance_m, float):
        distance_m = block.distance_m + added.distance_m
    if isinstance(added.correction.valid, float):
        valid_everywhere = added.correction.valid
    else:
        valid = added.correction.valid
    cdef Motion motion = carry_pose(mean[:3], mean[3:6], rate_rad_s, dt_s, distance_m)
    gain, matrix = np.empty((6, n)), np.zeros((r, r))
    cdef double[:, ::1] yaw_gain = gain, F = matrix
    cdef double[:, :, ::1] rate_gain = motion.rate_gain
    for i in range(6):
        for j in range(6):
            F[i, j] = motion.transition[i, j]
        for l in range(n):
            yaw_gain[i, l] = rate_gain[i, 2, l] * (valid_everywhere if valid is None else valid[l])
            F[i, 6] += rate_gain[i, 0, l]
            F[i, 7] += rate_gain[i, 1, l]
            F[i, 8] += yaw_gain[i, l]
            for j in range(k):
                F[i, 9 + j] += yaw_gain[i, l] * by_values[l, j]
    for i in range(6, r):
        F[i, i] = 1.0
    F[8, 8] = bias_kept
    if added.distance_by_values is not None:
        more = added.distance_by_values
        for i in range(3):
            for l in range(n):
                for j in range(k):
                    F[i, 9 + j] += motion.forward[i, l] * more[l, j]
    if added.drift_by_values is not None:
        more = added.drift_by_values
        for i in range(3):
            for j in range(k):
                F[i, 9 + j] += more[i, j]
    carried = carry_covariance(state.covariance, state.sensitivity, F)
    add_process_noise(noise, motion, dt_s, block.rate_rad_s, by_wheels_m, carried[0])
    after = np.array(mean)
    cdef double[::1] moved = after
    for i in range(3):
        moved[i], moved[3 + i] = motion.position[i], motion.euler[i]
    if not isinstance(added.drift_m, float):
        drift_m = added.drift_m
        for i in range(3):
            moved[i] += drift_m[i]
    moved[8] = bias_rad_s
    return (after, *carried, matrix, gain, *motion.arrays)


def corrected_rates(
    const double[:, :] rate_rad_s, const double[:] correction_rad_s, valid, const double[:] bias_rad_s
):
    cdef Py_ssize_t n = rate_rad_s.shape[0], k
    cdef const double[:] acts = None if isinstance(valid, float) else valid
    cdef double bias = bias_rad_s[2] * (valid if acts is None else 1.0)
    result = np.empty((n, 3))
    cdef double[:, ::1] rate = result
    for k in range(n):
        rate[k, 0] = rate_rad_s[k, 0] + bias_rad_s[0]
        rate[k, 1] = rate_rad_s[k, 1] + bias_rad_s[1]
        rate[k, 2] = rate_rad_s[k, 2] + correction_rad_s[k] + bias * (1.0 if acts is None else acts[k])
    return result


cdef tuple carry_covariance(
    const double[:, ::1] covariance, const double[:, ::1] sensitivity, const double[:, ::1] matrix
):
    """Twin of the same name, without noise."""
    cdef Py_ssize_t n = covariance.shape[0], r = matrix.shape[0], c = sensitivity.shape[1], i, j, l
    cdef double factor
    result = np.empty((n, n))
    cdef double[:, ::1] P = result, FP = np.zeros((r, n))
    for i in range(r):
        for l in range(r):
            factor = matrix[i, l]
            if factor != 0.0:
                for j in range(n):
                    FP[i, j] += factor * covariance[l, j]
    for i in range(r):
        for j in range(r, n):
            P[i, j] = P[j, i] = FP[i, j]
        for j in range(i + 1):
            factor = 0.0
            for l in range(r):
                factor += FP[i, l] * matrix[j, l]
            P[i, j] = P[j, i] = factor
    for i in range(r, n):
        for j in range(r, n):
            P[i, j] = covariance[i, j]
    carried = np.empty((n, c))
    cdef double[:, ::1] X = carried
    for i in range(n):
        for j in range(c):
            X[i, j] = 0.0 if i < r else sensitivity[i, j]
    for i in range(r):
        for l in range(r):
            factor = matrix[i, l]
            if factor != 0.0:
                for j in range(c):
                    X[i, j] += factor * sensitivity[l, j]
    return result, carried


cdef void rotate(const double* euler, double[3][3] R) noexcept nogil:
    """Write the matrix of roll, pitch and yaw."""
    cdef double cr = cos(euler[0]), sr = sin(euler[0]), cp = cos(euler[1]), sp = sin(euler[1])
    cdef double cy = cos(euler[2]), sy = sin(euler[2])
    R[0][0], R[0][1], R[0][2] = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
    R[1][0], R[1][1], R[1][2] = sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr
    R[2][0], R[2][1], R[2][2] = -sp, cp * sr, cp * cr


def rotation_from_euler(const double[:] euler):
    cdef double angles[3]
    cdef Py_ssize_t i
    for i in range(3):
        angles[i] = euler[i]
    matrix = np.empty((3, 3))
    cdef double[:, ::1] R = matrix
    rotate(angles, <double[3]*>&R[0, 0])
    return matrix


def turned_camera(const double[:] euler, const double[:, :] R_bc):
    cdef Py_ssize_t i, j, k, l
    R_wb, dR_wb = rotation_from_euler(euler), rotation_derivatives(euler)
    arrays = (R_wb, dR_wb, np.zeros((3, 3)), np.zeros((3, 3, 3)))
    cdef double[:, ::1] R = R_wb, R_wc = arrays[2]
    cdef double[:, :, ::1] dR = dR_wb, dR_wc = arrays[3]
    for i in range(3):
        for j in range(3):
            for l in range(3):
                R_wc[i, j] += R[i, l] * R_bc[l, j]
                for k in range(3):
                    dR_wc[k, i, j] += dR[k, i, l] * R_bc[l, j]
    return arrays


def rotation_derivatives(const double[:] euler):
    cdef double cr = cos(euler[0]), sr = sin(euler[0]), cp = cos(euler[1]), sp = sin(euler[1])
    cdef double cy = cos(euler[2]), sy = sin(euler[2])
    matrices = np.zeros((3, 3, 3))
    cdef double[:, :, ::1] dR = matrices
    dR[0, 0, 1], dR[0, 0, 2] = cy * sp * cr + sy * sr, -cy * sp * sr + sy * cr
    dR[0, 1, 1], dR[0, 1, 2] = sy * sp * cr - cy * sr, -sy * sp * sr - cy * cr
    dR[0, 2, 1], dR[0, 2, 2] = cp * cr, -cp * sr
    dR[1, 0, 0], dR[1, 0, 1], dR[1, 0, 2] = -cy * sp, cy * cp * sr, cy * cp * cr
    dR[1, 1, 0], dR[1, 1, 1], dR[1, 1, 2] = -sy * sp, sy * cp * sr, sy * cp * cr
    dR[1, 2, 0], dR[1, 2, 1], dR[1, 2, 2] = -cp, -sp * sr, -sp * cr
    dR[2, 0, 0], dR[2, 0, 1], dR[2, 0, 2] = -sy * cp, -sy * sp * sr - cy * cr, -sy * sp * cr + cy * sr
    dR[2, 1, 0], dR[2, 1, 1], dR[2, 1, 2] = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
    return matrices
