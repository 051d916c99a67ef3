# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Twins of `ekf.equations.update`, `ekf.image_update`, `ekf.history.feature_likelihoods`, `ekf.equations.feature_scores`, `ekf.features.slow_errors` and
`ekf.noise.stamp_noise`, which explain the equations."""

from libc.math cimport M_PI, log, sqrt

cimport numpy as cnp
from numpy cimport ndarray as Array

from gyrocal_ros.errors import IndefiniteCovarianceError
from gyrocal_ros.kernels.arrays cimport at, at_integers, clear, cube, doubles, fourfold, integers, length, matrix, vector

cnp.import_array()

TWINS = (
    'corrected',
    'differences',
    'fit_heading',
    'given_others',
    'innovation_matrices',
    'position_score',
    'split_by_feature',
    'stamp_score',
)

cdef Py_ssize_t COEFFICIENTS_START = 9


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


cdef void add_moved(
    const double* by_position, const double* anchor, Py_ssize_t width, double* by_effects
) noexcept nogil:
    """Take off what effects (width) of the anchor (3, width) add to a derivative, given that by the pose (6)."""
    cdef Py_ssize_t i, l
    for i in range(3):
        for l in range(width):
            by_effects[l] -= by_position[i] * anchor[i * width + l]


def innovation_matrices(state, rows, prediction, measured, noise, by_values, by_candidates):
    landmarks = state.landmarks
    cdef Array P = doubles(state.covariance), X = doubles(state.sensitivity), which = integers(rows)
    cdef Array expected = doubles(prediction.expected), observed = doubles(measured), of_noise = doubles(noise)
    cdef Array by_pose = doubles(prediction.by_pose), by_feature = doubles(prediction.by_feature)
    cdef Array anchor_rows = integers(landmarks.anchor_rows), values = None, candidates = None
    cdef Array of_values = doubles(landmarks.anchors.by_values), of_candidates = doubles(landmarks.anchors.by_candidates)
    cdef Py_ssize_t m = length(expected), r = length(expected, 1), q = m * r, n = length(P), c = length(X, 1)
    cdef Py_ssize_t robot = COEFFICIENTS_START + <Py_ssize_t>state.coefficient_count, width = n + 1 + c
    cdef Py_ssize_t anchors_start = robot + 3 * length(anchor_rows), k = 0, given = 0, f, l, row, other, column, anchor
    if by_values is not None:
        values = doubles(by_values)
        k = length(values, 2)
    if by_candidates is not None:
        candidates = doubles(by_candidates)
        given = length(candidates, 2)
    cdef Py_ssize_t wide = 12 + k  # pose, own feature, its anchor and coefficients
    cdef Array residual = matrix(m, r), stacked = cube(m, r, width), covariance = fourfold(m, r, m, r), H = matrix(q, wide)
    cdef double sum_
    cdef double* total
    cdef double* weights
    cdef double* others
    cdef double* S = at(covariance)
    cdef bint has_anchors = n > anchors_start
    clear(at(stacked), q * width)
    for row in range(q):
        f = row // r
        column, anchor = robot + 3 * at_integers(which)[f], at_integers(anchor_rows)[at_integers(which)[f]]
        weights, total = at(H) + row * wide, at(stacked) + row * width
        for l in range(6):
            weights[l] = at(by_pose)[6 * row + l]
        for l in range(3):
            weights[6 + l] = at(by_feature)[3 * row + l]
            weights[9 + l] = -weights[l]
        for l in range(k):
            weights[12 + l] = at(values)[k * row + l]
        if k and has_anchors and length(of_values, 2):
            add_moved(weights, at(of_values) + at_integers(which)[f] * 3 * k, k, weights + 12)
        at(residual)[row] = total[n] = at(observed)[row] - at(expected)[row]
        add_rows(6, weights, at(P), n, total)
        add_rows(3, weights + 6, at(P) + column * n, n, total)
        if c:
            add_rows(6, weights, at(X), c, total + n + 1)
            add_rows(3, weights + 6, at(X) + column * c, c, total + n + 1)
        if anchor >= 0:
            anchor = anchors_start + 3 * anchor
            add_rows(3, weights + 9, at(P) + anchor * n, n, total)
            if c:
                add_rows(3, weights + 9, at(X) + anchor * c, c, total + n + 1)
        add_rows(k, weights + 12, at(P) + COEFFICIENTS_START * n, n, total)
        if c:
            add_rows(k, weights + 12, at(X) + COEFFICIENTS_START * c, c, total + n + 1)
        for l in range(given):
            total[n + 1 + l] += at(candidates)[given * row + l]
        if given and has_anchors and length(of_candidates, 2):
            add_moved(weights, at(of_candidates) + at_integers(which)[f] * 3 * given, given, total + n + 1)
    for row in range(q):
        total = at(stacked) + row * width
        for other in range(row + 1):
            f = other // r
            column, anchor = robot + 3 * at_integers(which)[f], at_integers(anchor_rows)[at_integers(which)[f]]
            others, sum_ = at(H) + other * wide, 0.0
            for l in range(6):
                sum_ += total[l] * others[l]
            for l in range(3):
                sum_ += total[column + l] * others[6 + l]
            if anchor >= 0:
                for l in range(3):
                    sum_ += total[anchors_start + 3 * anchor + l] * others[9 + l]
            for l in range(k):
                sum_ += total[COEFFICIENTS_START + l] * others[12 + l]
            if f == row // r:
                sum_ += at(of_noise)[row * r + other % r]
            S[row * q + other] = S[other * q + row] = sum_
    return residual, stacked, covariance


def fit_heading(innovation, Py_ssize_t yaw):
    cdef Array poses = doubles(innovation.prediction.by_pose), of_noise = doubles(innovation.noise)
    cdef Array of_residual = doubles(innovation.residual), S = doubles(innovation.covariance)
    cdef Py_ssize_t m = length(of_residual), f, row
    cdef double information = 0.0, score = 0.0, variance = 0.0, a, b, c, determinant, u, v, by_u, by_v
    cdef const double* noise
    cdef const double* residual
    for f in range(m):
        row = 2 * f * (2 * m) + 2 * f
        a, b, c = at(S)[row], at(S)[row + 1], at(S)[row + 2 * m + 1]
        noise, residual = at(of_noise) + 4 * f, at(of_residual) + 2 * f
        by_u, by_v = at(poses)[12 * f + yaw], at(poses)[12 * f + 6 + yaw]
        determinant = a * c - b * b
        if determinant == 0.0:
            raise IndefiniteCovarianceError
        u, v = (c * by_u - b * by_v) / determinant, (a * by_v - b * by_u) / determinant
        information += u * by_u + v * by_v
        score += u * residual[0] + v * residual[1]
        variance += u * (noise[0] * u + noise[1] * v) + v * (noise[2] * u + noise[3] * v)
    return score / information, sqrt(variance) / information


def corrected(mean, covariance, sensitivity, whitened, products, whitening):
    cdef Array x = doubles(mean), before = doubles(covariance), G = doubles(sensitivity), by = doubles(products)
    cdef Array white = doubles(whitened), W = doubles(whitening)
    cdef Py_ssize_t n = length(x), c = length(G, 1), width = n + 1 + c, q = length(W), i, j, l
    cdef double determinant = 0.0, nis = 0.0, size = 0.0
    cdef Array after = vector(n), P = matrix(n, n), X = matrix(n, c)
    cdef const double* source
    cdef const double* taken
    cdef double* row
    for i in range(n):
        taken, source, row = at(by) + i * width, at(before) + i * n, at(P) + i * n
        at(after)[i] = at(x)[i] + taken[n]
        size += at(after)[i] * at(after)[i]
        for j in range(i + 1):
            row[j] = source[j] - taken[j]
        source, row = at(G) + i * c, at(X) + i * c
        for j in range(c):
            row[j] = source[j] - taken[n + 1 + j]
    mirror(at(P), n)
    for l in range(q):
        nis += at(white)[l * width + n] * at(white)[l * width + n]
        determinant -= 2.0 * log(at(W)[l * (q + 1)])
    return after, P, X, nis, determinant, size


cdef void mirror(double* P, Py_ssize_t n) noexcept nogil:
    """Copy what is below the diagonal of a matrix (n, n) to above it, by blocks that stay in the cache."""
    cdef Py_ssize_t first, i, j
    for first in range(0, n, 8):
        for i in range(first, n):
            for j in range(first, min(first + 8, i)):
                P[j * n + i] = P[i * n + j]


def position_score(by_pose, residual, whitening, Py_ssize_t yaw):
    cdef Array poses = doubles(by_pose), of_residual = doubles(residual), of_whitening = doubles(whitening)
    cdef Py_ssize_t q = length(of_whitening), i, j
    cdef const double* derivative
    cdef const double* row
    cdef const double* nu = at(of_residual)
    cdef double white, x, y, turn
    # Sums of the products of what is whitened: by x, y and yaw, with each other and with the innovation.
    cdef double xx = 0.0, xy = 0.0, yy = 0.0, xt = 0.0, yt = 0.0, tt = 0.0, xn = 0.0, yn = 0.0, tn = 0.0
    for i in range(q):
        row = at(of_whitening) + i * q
        white = x = y = turn = 0.0
        for j in range(i + 1):  # L^-1 is lower triangular
            derivative = at(poses) + 6 * j
            white += row[j] * nu[j]
            x += row[j] * derivative[0]
            y += row[j] * derivative[1]
            turn += row[j] * derivative[yaw]
        xx += x * x
        xy += x * y
        yy += y * y
        xt += x * turn
        yt += y * turn
        tt += turn * turn
        xn += x * white
        yn += y * white
        tn += turn * white
    cdef Array score = vector(2), information = matrix(2, 2)
    at(score)[0], at(score)[1] = xn - xt * tn / tt, yn - yt * tn / tt
    at(information)[0], at(information)[3] = xx - xt * xt / tt, yy - yt * yt / tt
    at(information)[1] = at(information)[2] = xy - xt * yt / tt
    return score, information


cdef void whitened_columns(const double* W, const double* columns, Py_ssize_t n, Py_ssize_t q, double* axes) noexcept nogil:
    """Write the rows (q, n) of `(W C)^T`, for C (n, q) and W (n, n), which is lower triangular."""
    cdef Py_ssize_t i, j, l
    clear(axes, q * n)
    for i in range(n):
        for j in range(i + 1):
            for l in range(q):
                axes[l * n + i] += W[i * n + j] * columns[j * q + l]


cdef inline void take_off(const double* axis, double* row, Py_ssize_t n) noexcept nogil:
    """Take off what a row has in common with an axis of unit length."""
    cdef Py_ssize_t i
    cdef double along = 0.0
    for i in range(n):
        along += axis[i] * row[i]
    for i in range(n):
        row[i] -= along * axis[i]


cdef void make_orthonormal(double* axes, Py_ssize_t n, Py_ssize_t q) noexcept nogil:
    """Make rows (q, n) orthonormal by Gram and Schmidt, each twice, so that rounding does not grow."""
    cdef Py_ssize_t i, l, before, again
    cdef double square
    for l in range(q):
        for again in range(2):
            for before in range(l):
                take_off(axes + before * n, axes + l * n, n)
        square = 0.0
        for i in range(n):
            square += axes[l * n + i] ** 2
        square = 1.0 / sqrt(square) if square > 0.0 else 0.0
        for i in range(n):
            axes[l * n + i] *= square


def differences(residual, whitening, common):
    cdef Array of_residual = doubles(residual), of_whitening = doubles(whitening), columns = doubles(common)
    cdef Py_ssize_t m = length(of_residual), r = length(of_residual, 1), q = length(columns, 2), n = m * r
    cdef Py_ssize_t f, i, j, k, l
    if n < 2 * q:
        return matrix(0, r)
    # The axes of what is common, whitened, and the innovation without these; then the same times L^-T.
    cdef Array rows = matrix(q + 1, n), back = matrix(q + 1, n), result = matrix(m, r)
    cdef double* axes = at(rows)
    cdef double* left = at(back)
    cdef const double* W = at(of_whitening)
    cdef double own[3][3]
    cdef double different[3]
    cdef double total
    whitened_columns(W, at(columns), n, q, axes)
    whitened_columns(W, at(of_residual), n, 1, axes + q * n)
    make_orthonormal(axes, n, q)
    for l in range(q):
        take_off(axes + l * n, axes + q * n, n)
    clear(left, (q + 1) * n)
    for l in range(q + 1):
        for i in range(n):
            total = axes[l * n + i]
            for j in range(i + 1):
                left[l * n + j] += W[i * n + j] * total
    for f in range(m):
        for i in range(r):
            for j in range(i + 1):
                total = 0.0
                for k in range(f * r + i, n):
                    total += W[k * n + f * r + i] * W[k * n + f * r + j]
                for l in range(q):
                    total -= left[l * n + f * r + i] * left[l * n + f * r + j]
                for k in range(j):
                    total -= own[i][k] * own[j][k]
                if i == j and not total > 0.0:
                    return matrix(0, r)
                own[i][j] = sqrt(total) if i == j else total / own[j][j]
            different[i] = left[q * n + f * r + i]
            for k in range(i):
                different[i] -= own[i][k] * different[k]
            different[i] /= own[i][i]
            at(result)[f * r + i] = different[i]
    return result


def stamp_score(by_pose, rate, residual, whitening):
    cdef Array poses = doubles(by_pose), of_rate = doubles(rate), of_residual = doubles(residual)
    cdef Array of_whitening = doubles(whitening)
    cdef Py_ssize_t q = length(of_whitening), i, j
    cdef Array of_velocity = vector(q)
    cdef const double* nu = at(of_residual)
    cdef const double* row
    cdef double* velocity = at(of_velocity)
    cdef double by_error, white, score = 0.0, information = 0.0
    for i in range(q):
        velocity[i] = 0.0
        for j in range(6):
            velocity[i] += at(poses)[6 * i + j] * at(of_rate)[j]
    for i in range(q):
        row = at(of_whitening) + i * q
        by_error = white = 0.0
        for j in range(i + 1):  # L^-1 is lower triangular
            by_error += row[j] * velocity[j]
            white += row[j] * nu[j]
        score += by_error * white
        information += by_error * by_error
    return score, information


def given_others(residual, whitening):
    cdef Array of_residual = doubles(residual), of_whitening = doubles(whitening)
    cdef Py_ssize_t m = length(of_residual), r = length(of_residual, 1), q = m * r, f, i, j, l, first
    cdef double own[3][3]
    cdef double weighted[3]
    cdef double total, distance, log_determinant
    cdef const double* nu = at(of_residual)
    cdef const double* W = at(of_whitening)
    cdef Array whitened = vector(q), result = vector(m)
    cdef double* white = at(whitened)
    for i in range(q):
        white[i] = 0.0
        for j in range(i + 1):
            white[i] += W[i * q + j] * nu[j]
    for f in range(m):
        first = f * r
        distance, log_determinant = 0.0, 0.0
        for i in range(r):  # L^-1 is lower triangular
            weighted[i] = 0.0
            for l in range(first + i, q):
                weighted[i] += W[l * q + first + i] * white[l]
            for j in range(i + 1):
                total = 0.0
                for l in range(first + i, q):
                    total += W[l * q + first + i] * W[l * q + first + j]
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
        at(result)[f] = -0.5 * (distance - log_determinant + r * log(2.0 * M_PI))
    return result


def split_by_feature(both, weighted, whitening):
    cdef Array of_both = doubles(both), of_weighted = doubles(weighted), of_whitening = doubles(whitening)
    cdef Py_ssize_t m = length(of_both), r = length(of_both, 1), width = length(of_both, 2), c = width - 1, q = m * r
    cdef Py_ssize_t f, i, j, l
    cdef Array sums = cube(m, 2, c), variance = vector(c)
    cdef const double* G
    cdef const double* more
    cdef const double* precise
    cdef const double* W = at(of_whitening)
    cdef double* score
    cdef double* information
    cdef double* total = at(variance)
    cdef double own
    clear(at(sums), m * 2 * c)
    clear(total, c)
    for f in range(m):
        score, information = at(sums) + 2 * c * f, at(sums) + 2 * c * f + c
        for i in range(r):
            G, precise = at(of_both) + width * (r * f + i), at(of_weighted) + width * (r * f + i)
            for j in range(c):
                score[j] += G[j] * precise[c]
                information[j] += G[j] * precise[j]
            for j in range(i + 1):
                own = 0.0  # of S^-1: W is lower triangular
                for l in range(r * f + i, q):
                    own += W[q * l + r * f + i] * W[q * l + r * f + j]
                if j < i:
                    own *= 2.0
                more = at(of_both) + width * (r * f + j)
                for l in range(c):
                    total[l] += own * G[l] * more[l]
    return sums, variance
