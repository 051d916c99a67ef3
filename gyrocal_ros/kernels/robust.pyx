# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Twins of `ekf.positive_definite`, `ekf.robust`, `ekf.scale_watch` and `ekf.image_update`, which explain the
equations."""

from libc.math cimport fabs, sqrt

import numpy as np

from gyrocal_ros.errors import IndefiniteCovarianceError

TWINS = ('fit_heading', 'scale_changes', 'squared_norm', 'weigh', 'whitener')

cdef double TINY = np.finfo(float).tiny
cdef double NOT_SEPARABLE = 1e-9


cdef bint whiten(double[:, ::1] S, double[:, ::1] W) noexcept nogil:
    """Write L^-1 of a covariance (q, q), which is overwritten; return False where it has none.

    Rows of S become rows of L^T from above, and the same steps turn the unit matrix into L^-1.
    """
    cdef Py_ssize_t q = S.shape[0], i, j, l
    cdef double pivot, factor
    for i in range(q):
        for j in range(q):
            W[i, j] = 0.0
        W[i, i] = 1.0
    for j in range(q):
        pivot = S[j, j]
        if not pivot > 0.0:
            return False
        pivot = 1.0 / sqrt(pivot)
        for l in range(j, q):
            S[j, l] *= pivot
        for l in range(j + 1):
            W[j, l] *= pivot
        for i in range(j + 1, q):
            factor = S[j, i]
            for l in range(i, q):
                S[i, l] -= factor * S[j, l]
            for l in range(j + 1):
                W[i, l] -= factor * W[j, l]
    return True


cdef bint invert(double[:, ::1] S, double[:, ::1] inverse) noexcept nogil:
    """Write the inverse of a covariance (q, q), which is overwritten; return False where it has none."""
    cdef Py_ssize_t q = S.shape[0], i, j, l
    cdef double factor
    if not whiten(S, inverse):
        return False
    for i in range(q):
        for l in range(i + 1):
            S[i, l] = 0.0
    for j in range(q):
        for i in range(j + 1):
            factor = inverse[j, i]
            for l in range(i + 1):
                S[i, l] += factor * inverse[j, l]
    for i in range(q):
        for l in range(i + 1):
            inverse[i, l] = inverse[l, i] = S[i, l]
    return True


cdef bint invert_small(double* A, Py_ssize_t r, double* inverse) noexcept nogil:
    """Invert a symmetric matrix of 2 or 3 rows by its cofactors."""
    cdef double determinant
    if r == 2:
        determinant = A[0] * A[3] - A[1] * A[2]
        inverse[0], inverse[1] = A[3] / determinant, -A[1] / determinant
        inverse[2], inverse[3] = -A[2] / determinant, A[0] / determinant
        return determinant != 0.0
    inverse[0] = A[4] * A[8] - A[5] * A[7]
    inverse[1] = A[2] * A[7] - A[1] * A[8]
    inverse[2] = A[1] * A[5] - A[2] * A[4]
    inverse[3] = A[5] * A[6] - A[3] * A[8]
    inverse[4] = A[0] * A[8] - A[2] * A[6]
    inverse[5] = A[2] * A[3] - A[0] * A[5]
    inverse[6] = A[3] * A[7] - A[4] * A[6]
    inverse[7] = A[1] * A[6] - A[0] * A[7]
    inverse[8] = A[0] * A[4] - A[1] * A[3]
    determinant = A[0] * inverse[0] + A[1] * inverse[3] + A[2] * inverse[6]
    cdef Py_ssize_t i
    for i in range(9):
        inverse[i] /= determinant
    return determinant != 0.0


def weigh(innovation, double bound, double max_inflation, int max_iterations, double converged):
    cdef const double[:, ::1] residual = innovation.residual
    cdef Py_ssize_t m = residual.shape[0], r = residual.shape[1], q = m * r, f, i, j
    cdef const double[:, ::1] covariance = innovation.covariance.reshape(q, q)
    cdef const double[:, :, :] noise = innovation.noise
    cdef double weighted[3]
    cdef double difference[3]
    cdef double block[9]
    cdef double own[9]
    cdef double variance[9]
    cdef double precision[9]
    cdef double nis = 0.0, sum_, of_noise, total, wanted
    cdef bint is_plain = True, is_settled
    cdef int iteration
    arrays = (np.ones(m), np.empty(m), np.empty(m))
    cdef double[::1] inflation = arrays[0], distances = arrays[1], noise_share = arrays[2]
    cdef double[:, ::1] S = np.empty((q, q)), inverse = np.empty((q, q))
    cdef const double* nu = &residual[0, 0]
    for iteration in range(max_iterations):
        for f in range(m):
            for i in range(r):
                for j in range(q):
                    S[f * r + i, j] = covariance[f * r + i, j]
                for j in range(r):
                    S[f * r + i, f * r + j] += (inflation[f] - 1.0) * noise[f, i, j]
        if not invert(S, inverse):
            raise IndefiniteCovarianceError
        is_settled = True
        for f in range(m):
            for i in range(r):
                sum_ = 0.0
                for j in range(q):
                    sum_ += inverse[f * r + i, j] * nu[j]
                weighted[i] = sum_
                if iteration == 0:
                    nis += sum_ * residual[f, i]
                for j in range(r):
                    block[i * r + j] = inverse[f * r + i, f * r + j]
            if not invert_small(block, r, own):
                raise IndefiniteCovarianceError
            of_noise = total = sum_ = 0.0
            for i in range(r):
                difference[i] = 0.0
                for j in range(r):
                    difference[i] += own[i * r + j] * weighted[j]
                    variance[i * r + j] = own[i * r + j] - (inflation[f] - 1.0) * noise[f, i, j]
                of_noise += noise[f, i, i]
                total += variance[i * r + i]
            if is_plain:  # variance^-1 difference is y itself
                for i in range(r):
                    sum_ += difference[i] * weighted[i]
            else:
                if not invert_small(variance, r, precision):
                    raise IndefiniteCovarianceError
                for i in range(r):
                    for j in range(r):
                        sum_ += difference[i] * precision[i * r + j] * difference[j]
            if not sum_ >= 0.0:
                raise IndefiniteCovarianceError
            distances[f] = sum_
            noise_share[f] = of_noise / total
        is_plain = True
        for f in range(m):
            wanted = min(max(sqrt(distances[f]) / bound, 1.0), max_inflation)
            is_settled &= fabs(wanted - inflation[f]) <= converged * inflation[f]
            is_plain &= wanted == 1.0
            inflation[f] = wanted
        if is_settled:
            break
    return (*arrays, nis)


def squared_norm(innovation, const double[:] inflation, const long[:] chosen):
    cdef const double[:, ::1] residual = innovation.residual
    cdef const double[:, :, :, ::1] covariance = innovation.covariance
    cdef const double[:, :, :] noise = innovation.noise
    cdef Py_ssize_t m = chosen.shape[0], r = residual.shape[1], q = m * r, f, g, i, j, l
    cdef double[:, ::1] S = np.empty((q, q))
    cdef double[::1] white = np.empty(q)
    cdef double total = 0.0, pivot, factor
    for f in range(m):
        for i in range(r):
            white[f * r + i] = residual[chosen[f], i]
            for g in range(m):
                for j in range(r):
                    S[f * r + i, g * r + j] = covariance[chosen[f], i, chosen[g], j]
            for j in range(r):
                S[f * r + i, f * r + j] += (inflation[chosen[f]] - 1.0) * noise[chosen[f], i, j]
    for j in range(q):
        pivot = S[j, j]
        if not pivot > 0.0:
            raise IndefiniteCovarianceError
        total += white[j] * white[j] / pivot
        for i in range(j + 1, q):
            factor = S[j, i] / pivot
            white[i] -= factor * white[j]
            for l in range(i, q):
                S[i, l] -= factor * S[j, l]
    return total


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


def whitener(covariance):
    whitening = np.empty(covariance.shape)
    if not whiten(np.array(covariance), whitening):
        raise IndefiniteCovarianceError
    return whitening


def scale_changes(
    const double[:] information,
    const double[:] score,
    const double[:] nis,
    const double[:] dof,
    const double[:] least,
    const double[:, :] cross,
    others,
):
    cdef Py_ssize_t q = score.shape[0], p = cross.shape[1], i, j, l
    cdef double others_explained = others.explained, explained = 0.0, known, left, weight, seen
    cdef const double[:] others_score = others.score
    cdef double[:, ::1] precision = np.empty((p, p))
    arrays = (np.empty(q), np.empty(q), np.empty(q))
    cdef double[::1] values = arrays[0], variances = arrays[1], sigmas = arrays[2]
    for i in range(q):
        explained = max(explained, score[i] * score[i] / max(information[i], TINY))
    cdef bint beside = others_explained > explained
    if beside and not invert(np.array(others.information), precision):
        raise IndefiniteCovarianceError
    for i in range(q):
        known = left = max(information[i], TINY)
        seen = score[i]
        if beside:
            for j in range(p):
                weight = 0.0
                for l in range(p):
                    weight += cross[i, l] * precision[l, j]
                left -= weight * cross[i, j]
                seen -= weight * others_score[j]
            left = max(left, NOT_SEPARABLE * known)
        values[i] = seen / left
        variances[i] = max((nis[i] - seen * values[i]) / max(dof[i], 1.0), 1.0) / left
        sigmas[i] = 0.0 if left < least[i] else fabs(values[i]) / sqrt(variances[i])
    return arrays
