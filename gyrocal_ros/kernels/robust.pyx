# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Twins of `ekf.positive_definite`, `ekf.robust` and `ekf.scale_watch`, which explain the equations."""

from libc.math cimport fabs, sqrt
from libc.stdlib cimport abs

import numpy as np

from gyrocal_ros.errors import IndefiniteCovarianceError

TWINS = ('scale_changes', 'scores_added', 'solve', 'weigh', 'weigh_loosely', 'whitener')

cdef double TINY = np.finfo(float).tiny
cdef double NOT_SEPARABLE = 1e-9

cdef enum:  # columns of the sums of `ScaleWatch`
    AGE
    INFORMATION
    SCORE
    NIS
    DOF
    CROSS


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


cdef class Seen:
    """Innovation of m features, of r numbers each, without owning its arrays."""

    cdef const double[:, ::1] residual
    cdef const double[:, :, :, ::1] covariance
    cdef const double[:, :, :] noise
    cdef Py_ssize_t m, r, q

    def __cinit__(self, innovation):
        self.residual, self.covariance, self.noise = innovation.residual, innovation.covariance, innovation.noise
        self.m, self.r = self.residual.shape[0], self.residual.shape[1]
        self.q = self.m * self.r


cdef void inflate(Seen seen, const double* extra, const double* inflation, double* S) noexcept nogil:
    """Write the covariance (q, q) with inflated noise, and with more (q, q) unless that is NULL."""
    cdef Py_ssize_t m = seen.m, r = seen.r, q = seen.q, f, i, j
    cdef const double* covariance = &seen.covariance[0, 0, 0, 0]
    for i in range(q * q):
        S[i] = covariance[i]
    if extra != NULL:
        for i in range(q * q):
            S[i] += extra[i]
    for f in range(m):
        if inflation[f] != 1.0:
            for i in range(r):
                for j in range(r):
                    S[(f * r + i) * q + f * r + j] += (inflation[f] - 1.0) * seen.noise[f, i, j]


cdef class Weighing:
    """What `weigh` returns, before it is arrays."""

    cdef object inflation, distances, noise_share, whitening
    cdef double nis


cdef Weighing weighed(
    Seen seen, const double* extra, double bound, double max_inflation, int max_iterations, double converged
):
    """Weigh with a covariance that is larger by more (q, q) unless that is NULL."""
    cdef Py_ssize_t m = seen.m, r = seen.r, q = seen.q, f, i, j, l
    cdef double difference[3]
    cdef double own[9]
    cdef double block[9]
    cdef double variance[9]
    cdef double precision[9]
    cdef double sum_, of_noise, total, wanted
    cdef bint is_plain = True, is_settled
    cdef int iteration
    cdef Weighing result = Weighing()
    result.inflation, result.distances, result.noise_share = np.ones(m), np.empty(m), np.empty(m)
    result.whitening, result.nis = np.empty((q, q)), 0.0
    cdef double[::1] inflation = result.inflation, distances = result.distances, noise_share = result.noise_share
    cdef double[:, ::1] first = result.whitening, W = first, work = np.empty((q + r + 2, q))
    cdef double[:, ::1] S = work[:q]
    cdef double* white = &work[q, 0]
    cdef double* weighted = &work[q + 1, 0]
    cdef double* beside = &work[q + 2, 0]
    cdef const double* nu = &seen.residual[0, 0]
    cdef const double* row
    for iteration in range(max_iterations):
        if iteration == 1:
            W = np.empty((q, q))
        inflate(seen, extra, &inflation[0], &S[0, 0])
        if not whiten(S, W):
            raise IndefiniteCovarianceError
        # y = S^-1 nu, diagonal of S^-1 and what is up to r beside it, by S^-1 = W^T W.
        for i in range(q):
            weighted[i] = 0.0
        for i in range(q * r):
            beside[i] = 0.0
        for j in range(q):
            row, sum_ = &W[j, 0], 0.0
            for i in range(j + 1):
                sum_ += row[i] * nu[i]
            white[j] = sum_
            if iteration == 0:
                result.nis += sum_ * sum_
            for i in range(j + 1):
                weighted[i] += row[i] * sum_
            for l in range(r):  # beyond j the row is zero
                for i in range(min(j + 1, q - l)):
                    beside[l * q + i] += row[i] * row[i + l]
        is_settled = True
        for f in range(m):
            for i in range(r):
                for j in range(r):
                    block[i * r + j] = beside[abs(i - j) * q + f * r + min(i, j)]
            if not invert_small(block, r, own):
                raise IndefiniteCovarianceError
            of_noise = total = sum_ = 0.0
            for i in range(r):
                difference[i] = 0.0
                for j in range(r):
                    difference[i] += own[i * r + j] * weighted[f * r + j]
                    variance[i * r + j] = own[i * r + j] - (inflation[f] - 1.0) * seen.noise[f, i, j]
                of_noise += seen.noise[f, i, i]
                total += variance[i * r + i]
            if is_plain:  # variance^-1 difference is y itself
                for i in range(r):
                    sum_ += difference[i] * weighted[f * r + i]
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
    return result


def weigh(innovation, double bound, double max_inflation, int max_iterations, double converged):
    cdef Weighing found = weighed(Seen(innovation), NULL, bound, max_inflation, max_iterations, converged)
    return found.inflation, found.distances, found.noise_share, found.nis, found.whitening


def weigh_loosely(
    innovation, const double[:] std, double bound, double max_inflation, int max_iterations, double converged
):
    cdef Seen seen = Seen(innovation)
    cdef const double[:, :, :] by_pose = innovation.prediction.by_pose
    cdef Py_ssize_t m = seen.m, r = seen.r, q = seen.q, p = std.shape[0], i, j, l
    cdef double sum_
    cdef double[:, ::1] loose = np.empty((q, q)), scaled = np.empty((q, p))
    for i in range(q):
        for l in range(p):
            scaled[i, l] = by_pose[i // r, i % r, l] * std[l]
        for j in range(i + 1):
            sum_ = 0.0
            for l in range(p):
                sum_ += scaled[i, l] * scaled[j, l]
            loose[i, j] = loose[j, i] = sum_
    cdef Weighing found = weighed(seen, &loose[0, 0], bound, max_inflation, max_iterations, converged)
    cdef const double[::1] inflation = found.inflation, distances = found.distances
    cdef long[::1] closest = np.empty(m, np.int64)
    sort(&distances[0], &closest[0], m)
    m = (m + 1) // 2
    return (
        found.inflation,
        found.distances,
        found.noise_share,
        found.nis,
        squared_norm(seen, NULL, &inflation[0], &closest[0], m),
        squared_norm(seen, &loose[0, 0], &inflation[0], &closest[0], m),
    )


cdef void sort(const double* values, long* order, Py_ssize_t m) noexcept nogil:
    """Write the indices of m values, from the smallest to the largest."""
    cdef Py_ssize_t i, j
    for i in range(m):
        j = i
        while j > 0 and values[order[j - 1]] > values[i]:
            order[j] = order[j - 1]
            j -= 1
        order[j] = i


cdef double squared_norm(
    Seen seen, const double* extra, const double* inflation, const long* chosen, Py_ssize_t m
) except -1.0:
    """Return nu^T S^-1 nu of the m features of the given indices, with S as in `inflate`."""
    cdef Py_ssize_t r = seen.r, q = m * r, f, g, i, j, l
    cdef double[:, ::1] S = np.empty((seen.q + q + 1, seen.q))
    cdef double* white = &S[seen.q, 0]
    cdef double* small = &S[seen.q + 1, 0]
    cdef double total = 0.0, pivot, factor
    inflate(seen, extra, inflation, &S[0, 0])
    for f in range(m):
        for i in range(r):
            white[f * r + i] = seen.residual[chosen[f], i]
            for g in range(m):
                for j in range(r):
                    small[(f * r + i) * q + g * r + j] = S[chosen[f] * r + i, chosen[g] * r + j]
    for j in range(q):
        pivot = small[j * q + j]
        if not pivot > 0.0:
            raise IndefiniteCovarianceError
        total += white[j] * white[j] / pivot
        for i in range(j + 1, q):
            factor = small[j * q + i] / pivot
            white[i] -= factor * white[j]
            for l in range(i, q):
                small[i * q + l] -= factor * small[j * q + l]
    return total


def solve(matrix, const double[:] right):
    cdef Py_ssize_t q = right.shape[0], i, j
    cdef double[:, ::1] W = np.empty((q, q))
    cdef double white
    if not whiten(np.array(matrix), W):
        raise IndefiniteCovarianceError
    result = np.zeros(q)
    cdef double[::1] solution = result
    for j in range(q):
        white = 0.0
        for i in range(j + 1):
            white += W[j, i] * right[i]
        for i in range(j + 1):
            solution[i] += W[j, i] * white
    return result


def whitener(covariance):
    whitening = np.empty(covariance.shape)
    if not whiten(np.array(covariance), whitening):
        raise IndefiniteCovarianceError
    return whitening


def scores_added(
    const double[:, ::1] sums,
    const double[:, :] information,
    const double[:] score,
    double nis,
    double dof,
    Py_ssize_t first,
):
    cdef Py_ssize_t q = sums.shape[0], p = sums.shape[1] - CROSS, i, j
    result = np.array(sums)
    cdef double[:, ::1] out = result
    for i in range(q):
        out[i, INFORMATION] += information[first + i, first + i]
        out[i, SCORE] += score[first + i]
        out[i, NIS] += nis
        out[i, DOF] += dof
        for j in range(p):
            out[i, CROSS + j] += information[first + i, first - p + j]
    return result


def scale_changes(const double[:, ::1] sums, others, double least, double ramp_s):
    cdef Py_ssize_t q = sums.shape[0], p = sums.shape[1] - CROSS, i, j, l
    cdef double others_explained = others.explained, explained = 0.0, known, left, weight, seen
    cdef const double[:] others_score = others.score
    cdef double[:, ::1] precision = None
    arrays = (np.empty(q), np.empty(q), np.empty(q))
    cdef double[::1] values = arrays[0], variances = arrays[1], sigmas = arrays[2]
    for i in range(q):
        explained = max(explained, sums[i, SCORE] * sums[i, SCORE] / max(sums[i, INFORMATION], TINY))
    cdef bint beside = others_explained > explained
    if beside:
        precision = np.empty((p, p))
        if not invert(np.array(others.information), precision):
            raise IndefiniteCovarianceError
    for i in range(q):
        known = left = max(sums[i, INFORMATION], TINY)
        seen = sums[i, SCORE]
        if beside:
            for j in range(p):
                weight = 0.0
                for l in range(p):
                    weight += sums[i, CROSS + l] * precision[l, j]
                left -= weight * sums[i, CROSS + j]
                seen -= weight * others_score[j]
            left = max(left, NOT_SEPARABLE * known)
        values[i] = seen / left
        variances[i] = max((sums[i, NIS] - seen * values[i]) / max(sums[i, DOF], 1.0), 1.0) / left
        if i == q - 1:
            least *= (sums[i, AGE] / ramp_s) * (sums[i, AGE] / ramp_s)
        sigmas[i] = 0.0 if left < least else fabs(values[i]) / sqrt(variances[i])
    return arrays
