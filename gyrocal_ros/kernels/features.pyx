# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Twins of `model.camera`, `effects.camera_tilt`, `model.features.inverse_depth`, `ekf.image_update`,
`ekf.feature_likelihoods` and `ekf.update`, which explain the equations."""

from libc.math cimport M_PI, atan, cos, log, sin, sqrt

import numpy as np

from gyrocal_ros.errors import IndefiniteCovarianceError

TWINS = (
    'corrected',
    'fit_heading',
    'given_others',
    'innovation_matrices',
    'pixels_by_radial_coefficients',
    'pixels_by_tilt',
    'position_score',
    'predict_inverse_depth',
    'project_with_jacobian',
)

cdef enum Lens:
    PINHOLE
    BROWN
    EQUIDISTANT

cdef double MIN_DEPTH = 1e-6
cdef Py_ssize_t COEFFICIENTS_START = 9
cdef double SMALL_RADIUS = 1e-4


cdef struct Camera:
    Lens lens
    double fx, fy, cx, cy
    double k[8]


cdef Camera camera_of(object intrinsics):
    cdef Camera camera
    cdef tuple distortion = intrinsics.distortion
    cdef Py_ssize_t i
    camera.fx, camera.fy = intrinsics.fx_px, intrinsics.fy_px
    camera.cx, camera.cy = intrinsics.cx_px, intrinsics.cy_px
    for i in range(8):
        camera.k[i] = 0.0
    for i in range(len(distortion)):
        camera.k[i] = distortion[i]
    if intrinsics.lens == 'equidistant':
        camera.lens = EQUIDISTANT
    else:
        camera.lens = BROWN if any(distortion) else PINHOLE
    return camera


cdef void distort(Camera* camera, double x, double y, double* at, double* slopes) noexcept nogil:
    """Write the distorted coordinates (2) and their derivative (3): by xx, xy = yx and yy."""
    cdef double* k = camera.k
    cdef double xx = x * x, yy = y * y, xy = x * y
    cdef double r2 = xx + yy
    cdef double radial, slope, denominator, angle, a2, bent, r
    if camera.lens == PINHOLE:
        at[0], at[1] = x, y
        slopes[0], slopes[1], slopes[2] = 1.0, 0.0, 1.0
        return
    if camera.lens == BROWN:
        radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
        slope = 2.0 * (k[0] + r2 * (2.0 * k[1] + r2 * (3.0 * k[4])))
        if k[5] != 0.0 or k[6] != 0.0 or k[7] != 0.0:
            denominator = 1.0 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
            radial = radial / denominator
            slope = (slope - radial * 2.0 * (k[5] + r2 * (2.0 * k[6] + r2 * (3.0 * k[7])))) / denominator
        at[0] = x * radial + 2.0 * k[2] * xy + k[3] * (r2 + 2.0 * xx)
        at[1] = y * radial + k[2] * (r2 + 2.0 * yy) + 2.0 * k[3] * xy
        slopes[0] = radial + slope * xx + 2.0 * k[2] * y + 6.0 * k[3] * x
        slopes[1] = slope * xy + 2.0 * (k[2] * x + k[3] * y)
        slopes[2] = radial + slope * yy + 6.0 * k[2] * y + 2.0 * k[3] * x
        return
    if r2 < SMALL_RADIUS * SMALL_RADIUS:
        slope = 2.0 * (k[0] - 1.0 / 3.0)
        radial = 1.0 + 0.5 * slope * r2
    else:
        r = sqrt(r2)
        angle = atan(r)
        a2 = angle * angle
        bent = angle * (1.0 + a2 * (k[0] + a2 * (k[1] + a2 * (k[2] + a2 * k[3]))))
        radial = bent / r
        slope = 1.0 + a2 * (3.0 * k[0] + a2 * (5.0 * k[1] + a2 * (7.0 * k[2] + a2 * 9.0 * k[3])))
        slope = (slope / (1.0 + r2) - radial) / r2
    at[0], at[1] = x * radial, y * radial
    slopes[0], slopes[1], slopes[2] = radial + slope * xx, slope * xy, radial + slope * yy


cdef void project(Camera* camera, double* point, double* pixel, double* jacobian) noexcept nogil:
    """Write the pixel (2) of a point (3) and its derivative (2, 3)."""
    cdef double inverse_z = 1.0 / max(point[2], MIN_DEPTH)
    cdef double x = point[0] * inverse_z, y = point[1] * inverse_z
    cdef double u[2]
    cdef double slopes[3]
    distort(camera, x, y, u, slopes)
    pixel[0], pixel[1] = u[0] * camera.fx + camera.cx, u[1] * camera.fy + camera.cy
    cdef double by_u = camera.fx * inverse_z, by_v = camera.fy * inverse_z
    jacobian[0], jacobian[1] = slopes[0] * by_u, slopes[1] * by_u
    jacobian[2] = -(slopes[0] * x + slopes[1] * y) * by_u
    jacobian[3], jacobian[4] = slopes[1] * by_v, slopes[2] * by_v
    jacobian[5] = -(slopes[1] * x + slopes[2] * y) * by_v


def project_with_jacobian(camera, const double[:, :] points_c):
    cdef Py_ssize_t m = points_c.shape[0], i, j
    cdef Camera lens = camera_of(camera)
    cdef double point[3]
    pixels, jacobian = np.empty((m, 2)), np.empty((m, 2, 3))
    cdef double[:, ::1] pixel = pixels
    cdef double[:, :, ::1] derivative = jacobian
    for i in range(m):
        for j in range(3):
            point[j] = points_c[i, j]
        project(&lens, point, &pixel[i, 0], &derivative[i, 0, 0])
    return pixels, jacobian


def predict_inverse_depth(
    camera,
    const double[:, :] R_wc,
    const double[:, :, :] dR_wc,
    const double[:] p_wb,
    const double[:] lever_c,
    const double[:, :] parameters,
    const double[:, :, :] anchor_R_wc,
    const double[:, :] anchor_p_wc,
):
    cdef Py_ssize_t m = parameters.shape[0], f, i, j, l
    cdef Camera lens = camera_of(camera)
    arrays = (
        np.empty((m, 2)), np.empty((m, 2, 6)), np.empty((m, 2, 3)), np.empty((m, 3)), np.empty((m, 2, 3)), np.empty(m)
    )
    cdef double[:, ::1] expected = arrays[0], points_c = arrays[3]
    cdef double[:, :, ::1] by_pose = arrays[1], by_feature = arrays[2], by_point = arrays[4]
    cdef double[::1] scale = arrays[5]
    cdef double to_anchor[3]
    cdef double from_robot[3]
    cdef double point_by_pose[3][6]
    cdef double point_by_feature[3][3]
    cdef double rho, sum_
    for f in range(m):
        rho = parameters[f, 2]
        scale[f] = rho
        for i in range(3):
            to_anchor[i] = anchor_p_wc[f, i] - p_wb[i]
            from_robot[i] = (
                anchor_R_wc[f, i, 0] * parameters[f, 0] + anchor_R_wc[f, i, 1] * parameters[f, 1]
                + anchor_R_wc[f, i, 2] + rho * to_anchor[i]
            )
        for i in range(3):
            points_c[f, i] = -rho * lever_c[i]
            point_by_feature[i][0] = point_by_feature[i][1] = 0.0
            point_by_feature[i][2] = -lever_c[i]
            for l in range(3):
                points_c[f, i] += from_robot[l] * R_wc[l, i]
                point_by_feature[i][0] += R_wc[l, i] * anchor_R_wc[f, l, 0]
                point_by_feature[i][1] += R_wc[l, i] * anchor_R_wc[f, l, 1]
                point_by_feature[i][2] += to_anchor[l] * R_wc[l, i]
                point_by_pose[i][l] = -rho * R_wc[l, i]
            for j in range(3):
                point_by_pose[i][3 + j] = 0.0
                for l in range(3):
                    point_by_pose[i][3 + j] += from_robot[l] * dR_wc[j, l, i]
        project(&lens, &points_c[f, 0], &expected[f, 0], &by_point[f, 0, 0])
        for i in range(2):
            for j in range(6):
                sum_ = 0.0
                for l in range(3):
                    sum_ += by_point[f, i, l] * point_by_pose[l][j]
                by_pose[f, i, j] = sum_
            for j in range(3):
                sum_ = 0.0
                for l in range(3):
                    sum_ += by_point[f, i, l] * point_by_feature[l][j]
                by_feature[f, i, j] = sum_
    return arrays


cdef void add_rows(
    Py_ssize_t count, const double* weights, const double* rows, Py_ssize_t width, double* total
) noexcept nogil:
    """Add a weighted sum of successive rows; three at a time, so that the total is read and written less often."""
    cdef Py_ssize_t i, l
    cdef double a, b, c
    for l in range(0, count - 2, 3):
        a, b, c = weights[l], weights[l + 1], weights[l + 2]
        for i in range(width):
            total[i] += a * rows[l * width + i] + b * rows[(l + 1) * width + i] + c * rows[(l + 2) * width + i]
    for l in range(count - count % 3, count):
        for i in range(width):
            total[i] += weights[l] * rows[l * width + i]


def innovation_matrices(
    const double[:, ::1] covariance,
    const double[:, ::1] sensitivity,
    const long[:] columns,
    const long[:] anchor_columns,
    const double[:, :] residual,
    const double[:, :, :] by_pose,
    const double[:, :, :] by_feature,
    const double[:, :, :] by_values,
    const double[:, :, :] by_candidates,
    const double[:, :, :] noise,
):
    cdef Py_ssize_t m = by_pose.shape[0], r = by_pose.shape[1], q = m * r, n = covariance.shape[0]
    cdef Py_ssize_t k = 0 if by_values is None else by_values.shape[2], c = sensitivity.shape[1]
    cdef Py_ssize_t of_candidates = 0 if by_candidates is None else by_candidates.shape[2]
    cdef Py_ssize_t f, g, i, j, l, row, column, anchor
    cdef double sum_
    cdef double* total
    cdef double* weights
    cdef double* others
    arrays = (np.zeros((m, r, n + 1 + c)), np.empty((m, r, m, r)))
    cdef double[:, :, ::1] stacked = arrays[0]
    cdef double[:, :, :, ::1] S = arrays[1]
    cdef double[:, ::1] H = np.empty((q, 12 + k))  # pose, own feature, its anchor and coefficients
    for f in range(m):
        column = columns[f]
        for i in range(r):
            weights, total = &H[f * r + i, 0], &stacked[f, i, 0]
            for l in range(6):
                weights[l] = by_pose[f, i, l]
            for l in range(3):
                weights[6 + l] = by_feature[f, i, l]
                weights[9 + l] = -by_pose[f, i, l]
            for l in range(k):
                weights[12 + l] = by_values[f, i, l]
            add_rows(6, weights, &covariance[0, 0], n, total)
            add_rows(3, weights + 6, &covariance[column, 0], n, total)
            total[n] = residual[f, i]
            if c:
                add_rows(6, weights, &sensitivity[0, 0], c, total + n + 1)
                add_rows(3, weights + 6, &sensitivity[column, 0], c, total + n + 1)
            anchor = anchor_columns[f]
            if anchor >= 0:
                add_rows(3, weights + 9, &covariance[anchor, 0], n, total)
                if c:
                    add_rows(3, weights + 9, &sensitivity[anchor, 0], c, total + n + 1)
            if k:
                add_rows(k, weights + 12, &covariance[COEFFICIENTS_START, 0], n, total)
                if c:
                    add_rows(k, weights + 12, &sensitivity[COEFFICIENTS_START, 0], c, total + n + 1)
            for l in range(of_candidates):
                total[n + 1 + l] += by_candidates[f, i, l]
    for row in range(q):
        total = &stacked[row // r, row % r, 0]
        for column in range(row + 1):
            g, j = column // r, column % r
            others, sum_ = &H[column, 0], 0.0
            for l in range(6):
                sum_ += total[l] * others[l]
            for l in range(3):
                sum_ += total[columns[g] + l] * others[6 + l]
            anchor = anchor_columns[g]
            if anchor >= 0:
                for l in range(3):
                    sum_ += total[anchor + l] * others[9 + l]
            for l in range(k):
                sum_ += total[COEFFICIENTS_START + l] * others[12 + l]
            if g == row // r:
                sum_ += noise[g, row % r, j]
            S[row // r, row % r, g, j] = S[g, j, row // r, row % r] = sum_
    return arrays


def pixels_by_tilt(const double[:, :] points_c, const double[:, :, :] by_point, double angle_rad):
    cdef Py_ssize_t m = points_c.shape[0], f, i
    cdef double c = cos(angle_rad), s = sin(angle_rad), x, y, z
    result = np.empty((m, by_point.shape[1], 2))
    cdef double[:, :, ::1] out = result
    for f in range(m):
        x, y, z = points_c[f, 0], points_c[f, 1], points_c[f, 2]
        for i in range(by_point.shape[1]):
            out[f, i, 0] = by_point[f, i, 1] * z - by_point[f, i, 2] * y
            out[f, i, 1] = -by_point[f, i, 0] * (s * y + c * z) + (s * by_point[f, i, 1] + c * by_point[f, i, 2]) * x
    return result


def pixels_by_radial_coefficients(camera, const double[:, :] points_c):
    cdef Camera lens = camera_of(camera)
    cdef double* k = lens.k
    cdef Py_ssize_t m = points_c.shape[0], f
    cdef double x, y, r2, r, angle, first, second, denominator
    result = np.empty((m, 2, 2))
    cdef double[:, :, ::1] out = result
    cdef bint is_fisheye = lens.lens == EQUIDISTANT
    for f in range(m):
        x, y = points_c[f, 0] / points_c[f, 2], points_c[f, 1] / points_c[f, 2]
        r2 = x * x + y * y
        if is_fisheye:
            r = max(sqrt(r2), SMALL_RADIUS)
            angle = atan(r)
            first = angle * angle * angle / r
            second = first * angle * angle
        else:
            denominator = 1.0 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
            first = r2 / denominator
            second = r2 * first
        out[f, 0, 0], out[f, 0, 1] = lens.fx * x * first, lens.fx * x * second
        out[f, 1, 0], out[f, 1, 1] = lens.fy * y * first, lens.fy * y * second
    return result


def fit_heading(innovation, Py_ssize_t yaw):
    cdef const double[:, :, :] by_pose = innovation.prediction.by_pose, noise = innovation.noise
    cdef const double[:, :] residual = innovation.residual
    cdef const double[:, :, :, :] covariance = innovation.covariance
    cdef Py_ssize_t m = residual.shape[0], f
    cdef double information = 0.0, score = 0.0, variance = 0.0, a, b, c, determinant, u, v
    for f in range(m):
        a, b, c = covariance[f, 0, f, 0], covariance[f, 0, f, 1], covariance[f, 1, f, 1]
        determinant = a * c - b * b
        if determinant == 0.0:
            raise IndefiniteCovarianceError
        u = (c * by_pose[f, 0, yaw] - b * by_pose[f, 1, yaw]) / determinant
        v = (a * by_pose[f, 1, yaw] - b * by_pose[f, 0, yaw]) / determinant
        information += u * by_pose[f, 0, yaw] + v * by_pose[f, 1, yaw]
        score += u * residual[f, 0] + v * residual[f, 1]
        variance += u * (noise[f, 0, 0] * u + noise[f, 0, 1] * v) + v * (noise[f, 1, 0] * u + noise[f, 1, 1] * v)
    return score / information, sqrt(variance) / information


def corrected(
    const double[:] mean,
    const double[:, ::1] covariance,
    const double[:, ::1] sensitivity,
    const double[:, ::1] products,
    const double[:, :] whitening,
):
    cdef Py_ssize_t n = mean.shape[0], c = sensitivity.shape[1], i, j
    cdef double determinant = 0.0
    arrays = (np.empty(n), np.empty((n, n)), np.empty((n, c)))
    cdef double[::1] after = arrays[0]
    cdef double[:, ::1] P = arrays[1], X = arrays[2]
    for i in range(n):
        after[i] = mean[i] + products[i, n]
        for j in range(n):
            P[i, j] = covariance[i, j] - products[i, j]
        for j in range(c):
            X[i, j] = sensitivity[i, j] - products[i, n + 1 + j]
    for i in range(whitening.shape[0]):
        determinant -= 2.0 * log(whitening[i, i])
    return (*arrays, determinant)


def position_score(
    const double[:, :, ::1] by_pose, const double[:, ::1] residual, const double[:, ::1] whitening, Py_ssize_t yaw
):
    cdef Py_ssize_t r = residual.shape[1], q = residual.shape[0] * r, i, j
    cdef const double* derivative
    cdef double weight, white, x, y, turn
    # Sums of the products of what is whitened: by x, y and yaw, with each other and with the innovation.
    cdef double xx = 0.0, xy = 0.0, yy = 0.0, xt = 0.0, yt = 0.0, tt = 0.0, xn = 0.0, yn = 0.0, tn = 0.0
    for i in range(q):
        white = x = y = turn = 0.0
        for j in range(i + 1):  # L^-1 is lower triangular
            weight, derivative = whitening[i, j], &by_pose[j // r, j % r, 0]
            white += weight * residual[j // r, j % r]
            x += weight * derivative[0]
            y += weight * derivative[1]
            turn += weight * derivative[yaw]
        xx += x * x
        xy += x * y
        yy += y * y
        xt += x * turn
        yt += y * turn
        tt += turn * turn
        xn += x * white
        yn += y * white
        tn += turn * white
    score, information = np.empty(2), np.empty((2, 2))
    score[0], score[1] = xn - xt * tn / tt, yn - yt * tn / tt
    information[0, 0], information[1, 1] = xx - xt * xt / tt, yy - yt * yt / tt
    information[0, 1] = information[1, 0] = xy - xt * yt / tt
    return score, information


def given_others(const double[:, ::1] residual, const double[:, ::1] whitening):
    cdef Py_ssize_t m = residual.shape[0], r = residual.shape[1], q = m * r, f, i, j, l, first
    cdef double own[3][3]
    cdef double weighted[3]
    cdef double total, distance, log_determinant
    cdef double[::1] white = np.empty(q)
    result = np.empty(m)
    cdef double[::1] out = result
    for i in range(q):
        white[i] = 0.0
        for j in range(i + 1):
            white[i] += whitening[i, j] * residual[j // r, j % r]
    for f in range(m):
        first = f * r
        distance, log_determinant = 0.0, 0.0
        for i in range(r):  # L^-1 is lower triangular
            weighted[i] = 0.0
            for l in range(first + i, q):
                weighted[i] += whitening[l, first + i] * white[l]
            for j in range(i + 1):
                total = 0.0
                for l in range(first + i, q):
                    total += whitening[l, first + i] * whitening[l, first + j]
                own[i][j] = total
        for i in range(r):  # Cholesky's factor of the own block, and y whitened by it
            for j in range(i + 1):
                total = own[i][j]
                for l in range(j):
                    total -= own[i][l] * own[j][l]
                own[i][j] = sqrt(total) if i == j else total / own[j][j]
            for l in range(i):
                weighted[i] -= own[i][l] * weighted[l]
            weighted[i] /= own[i][i]
            distance += weighted[i] * weighted[i]
            log_determinant += 2.0 * log(own[i][i])
        out[f] = -0.5 * (distance - log_determinant + r * log(2.0 * M_PI))
    return result
