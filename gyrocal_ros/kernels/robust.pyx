# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Twins of `ekf.features.robust`, which explains the equations."""

from libc.math cimport fabs, sqrt
from libc.stdlib cimport abs
from libc.string cimport memcpy

cimport numpy as cnp
from numpy cimport ndarray as Array

from gyrocal_ros.errors import IndefiniteCovarianceError
from gyrocal_ros.kernels.arrays cimport at, at_integers, doubles, indices, length, matrix, vector
from gyrocal_ros.kernels.positive_definite cimport whiten

cnp.import_array()

TWINS = ('looser_pose_gain', 'weigh', 'weigh_loosely')


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
    """Innovation of m features, of r numbers each."""

    cdef Array residual, covariance, noise
    cdef Py_ssize_t m, r, q

    def __cinit__(self, innovation):
        self.residual, self.covariance = doubles(innovation.residual), doubles(innovation.covariance)
        self.noise = doubles(innovation.noise)
        self.m, self.r = length(self.residual), length(self.residual, 1)
        self.q = self.m * self.r


cdef void inflate(Seen seen, const double* extra, const double* inflation, double* S) noexcept:
    """Write the covariance (q, q) with inflated noise, and with more (q, q) unless that is NULL."""
    cdef Py_ssize_t m = seen.m, r = seen.r, q = seen.q, f, i, j
    cdef const double* noise = at(seen.noise)
    memcpy(S, at(seen.covariance), q * q * sizeof(double))
    if extra != NULL:
        for i in range(q * q):
            S[i] += extra[i]
    for f in range(m):
        if inflation[f] != 1.0:
            for i in range(r):
                for j in range(r):
                    S[(f * r + i) * q + f * r + j] += (inflation[f] - 1.0) * noise[(f * r + i) * r + j]


cdef class Weighing:
    """What `weigh` returns, before it is arrays."""

    cdef Array inflation, distances, noise_share, whitening
    cdef double nis


cdef Array ones(Py_ssize_t m):
    cdef Array values = vector(m)
    cdef Py_ssize_t f
    for f in range(m):
        at(values)[f] = 1.0
    return values


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
    result.inflation, result.distances, result.noise_share = ones(m), vector(m), vector(m)
    result.whitening, result.nis = matrix(q, q), 0.0
    cdef double* inflation = at(result.inflation)
    cdef double* distances = at(result.distances)
    cdef Array work = matrix(2 * q + r + 2, q)
    cdef double* S = at(work)
    cdef double* white = S + q * q
    cdef double* weighted = white + q
    cdef double* beside = weighted + q
    cdef double* W = at(result.whitening)
    cdef const double* noise = at(seen.noise)
    cdef const double* nu = at(seen.residual)
    cdef const double* row
    for iteration in range(max_iterations):
        if iteration == 1:
            W = beside + r * q
        inflate(seen, extra, inflation, S)
        if not whiten(S, W, q):
            raise IndefiniteCovarianceError
        # y = S^-1 nu, diagonal of S^-1 and what is up to r beside it, by S^-1 = W^T W.
        for i in range(q):
            weighted[i] = 0.0
        for i in range(q * r):
            beside[i] = 0.0
        for j in range(q):
            row, sum_ = W + j * q, 0.0
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
                    variance[i * r + j] = own[i * r + j] - (inflation[f] - 1.0) * noise[(f * r + i) * r + j]
                of_noise += noise[(f * r + i) * r + i]
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
            at(result.noise_share)[f] = of_noise / total
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


cdef Array looser_pose(innovation, Seen seen, Array std):
    """Return what further errors of the pose (6,) add to the covariance, (q, q)."""
    cdef Array by_pose = doubles(innovation.prediction.by_pose)
    cdef Py_ssize_t q = seen.q, p = length(std), i, j, l
    cdef double sum_
    cdef Array loose = matrix(q, q), scaled = matrix(q, p)
    cdef const double* one
    cdef const double* other
    for i in range(q):
        for l in range(p):
            at(scaled)[i * p + l] = at(by_pose)[i * p + l] * at(std)[l]
    for i in range(q):
        one = at(scaled) + i * p
        for j in range(i + 1):
            sum_, other = 0.0, at(scaled) + j * p
            for l in range(p):
                sum_ += one[l] * other[l]
            at(loose)[i * q + j] = at(loose)[j * q + i] = sum_
    return loose


def looser_pose_gain(innovation, std, distances):
    cdef Seen seen = Seen(innovation)
    cdef Py_ssize_t m = seen.m
    cdef Array loose = looser_pose(innovation, seen, doubles(std)), uninflated = ones(m), squares = doubles(distances)
    cdef Array closest = indices(m)
    sort(at(squares), at_integers(closest), m)
    m = (m + 1) // 2
    return squared_norm(seen, NULL, at(uninflated), at_integers(closest), m) - squared_norm(
        seen, at(loose), at(uninflated), at_integers(closest), m
    )


def weigh_loosely(innovation, std, double bound, double max_inflation, int max_iterations, double converged):
    cdef Seen seen = Seen(innovation)
    cdef Py_ssize_t m = seen.m
    cdef Array loose = looser_pose(innovation, seen, doubles(std)), closest = indices(m)
    cdef Weighing found = weighed(seen, at(loose), bound, max_inflation, max_iterations, converged)
    sort(at(found.distances), at_integers(closest), m)
    m = (m + 1) // 2
    return (
        found.inflation,
        found.distances,
        found.noise_share,
        found.nis,
        squared_norm(seen, NULL, at(found.inflation), at_integers(closest), m),
        squared_norm(seen, at(loose), at(found.inflation), at_integers(closest), m),
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
    cdef Py_ssize_t r = seen.r, q = m * r, all_ = seen.q, f, g, i, j, l
    cdef Array work = matrix(all_ + q + 1, all_)
    cdef double* S = at(work)
    cdef double* white = S + all_ * all_
    cdef double* small = white + all_
    cdef double total = 0.0, pivot, factor
    inflate(seen, extra, inflation, S)
    for f in range(m):
        for i in range(r):
            white[f * r + i] = at(seen.residual)[chosen[f] * r + i]
            for g in range(m):
                for j in range(r):
                    small[(f * r + i) * q + g * r + j] = S[(chosen[f] * r + i) * all_ + chosen[g] * r + j]
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
