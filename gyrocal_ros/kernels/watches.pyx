# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Twins of `ekf.features.known_depth`, `ekf.noise.noise_bank`, `ekf.state.positive_definite`, `ekf.watches.scale_watch` and `ekf.features.slow_errors`, which
explain the equations."""

from libc.float cimport DBL_MIN
from libc.math cimport fabs, sqrt

cimport numpy as cnp
from numpy cimport ndarray as Array

from gyrocal_ros.errors import IndefiniteCovarianceError
from gyrocal_ros.kernels.arrays cimport at, at_integers, clear, copied, doubles, integers, length, matrix, vector
from gyrocal_ros.kernels.positive_definite cimport invert, whiten

cnp.import_array()

TWINS = (
    'equations_added',
    'products_with_last',
    'scale_changes',
    'scores_added',
    'scores_weighted',
    'solve',
    'variances_grown',
    'whitener',
)

cdef double NOT_SEPARABLE = 1e-9

cdef enum:  # columns of the sums of `ScaleWatch`
    INFORMATION
    SCORE
    NIS
    DOF
    CROSS


cdef bint solve_to(Array left, Array right, Array solution):
    """Write the solution (q,) of equations with a positive definite matrix (q, q); return False where it is none."""
    cdef Py_ssize_t q = length(right), i, j
    cdef Array work = copied(left), whitening = matrix(q, q)
    cdef const double* row
    cdef double white
    if not whiten(at(work), at(whitening), q):
        return False
    clear(at(solution), q)
    for j in range(q):
        row, white = at(whitening) + j * q, 0.0
        for i in range(j + 1):
            white += row[i] * at(right)[i]
        for i in range(j + 1):
            at(solution)[i] += row[i] * white
    return True


def solve(left, right):
    cdef Array values = doubles(right), solution = vector(length(values))
    if not solve_to(doubles(left), values, solution):
        raise IndefiniteCovarianceError
    return solution


def equations_added(sums, information, score, Py_ssize_t first):
    cdef Array summed = copied(doubles(sums.information)), total = copied(doubles(sums.score))
    cdef Array added = doubles(information), by = doubles(score)
    cdef Py_ssize_t q = length(total), c = length(by), i, j
    cdef Array values = vector(q)
    cdef double explained = 0.0
    for i in range(q):
        at(total)[i] += at(by)[first + i]
        for j in range(q):
            at(summed)[i * q + j] += at(added)[(first + i) * c + first + j]
    if not solve_to(summed, total, values):
        raise IndefiniteCovarianceError
    for i in range(q):
        explained += at(total)[i] * at(values)[i]
    return summed, total, values, explained


def whitener(covariance):
    cdef Array work = copied(doubles(covariance))
    cdef Array whitening = matrix(length(work), length(work))
    if not whiten(at(work), at(whitening), length(work)):
        raise IndefiniteCovarianceError
    return whitening


def scores_added(sums, information, score, double nis, double dof, Py_ssize_t first):
    cdef Array result = copied(doubles(sums)), added = doubles(information), by = doubles(score)
    cdef Py_ssize_t q = length(result), width = length(result, 1), p = width - CROSS, c = length(by), i, j
    cdef double* out
    cdef const double* row
    for i in range(q):
        out, row = at(result) + i * width, at(added) + (first + i) * c
        out[INFORMATION] += row[first + i]
        out[SCORE] += at(by)[first + i]
        out[NIS] += nis
        out[DOF] += dof
        for j in range(p):
            out[CROSS + j] += row[first - p + j]
    return result


def scores_weighted(information, score, weights):
    cdef Array result = copied(doubles(information)), by = copied(doubles(score)), weight = doubles(weights)
    cdef Py_ssize_t c = length(by), i, j
    for i in range(c):
        at(by)[i] *= at(weight)[i]
        for j in range(c):
            at(result)[i * c + j] *= at(weight)[i] * at(weight)[j]
    return result, by


def variances_grown(grown, before, expected, places):
    cdef Array total = copied(doubles(grown)), last = doubles(before), P = doubles(expected), which = integers(places)
    cdef Py_ssize_t across = length(P) + 1, i
    for i in range(length(total)):
        at(total)[i] += max(at(P)[at_integers(which)[i] * across] - at(last)[i], 0.0)
    return total


def scale_changes(sums, others, Py_ssize_t first, double least, double grown):
    cdef Array of_windows = doubles(sums), others_score = doubles(others.score), work, precision = None
    cdef Py_ssize_t q = length(of_windows), width = length(of_windows, 1), p = length(others_score), i, j, l
    cdef double others_explained = others.explained, explained = 0.0, known, left, weight, seen
    cdef Array values = vector(q), variances = vector(q), sigmas = vector(q)
    cdef const double* sum_
    for i in range(q):
        sum_ = at(of_windows) + i * width
        explained = max(explained, sum_[SCORE] * sum_[SCORE] / max(sum_[INFORMATION], DBL_MIN))
    cdef bint beside = others_explained - p > explained
    if beside:
        work, precision = copied(doubles(others.information)), matrix(p, p)
        if not invert(at(work), at(precision), p):
            raise IndefiniteCovarianceError
    for i in range(q):
        sum_ = at(of_windows) + i * width
        known = left = max(sum_[INFORMATION], DBL_MIN)
        seen = sum_[SCORE]
        if beside:
            for j in range(p):
                weight = 0.0
                for l in range(p):
                    weight += sum_[CROSS + first + l] * at(precision)[l * p + j]
                left -= weight * sum_[CROSS + first + j]
                seen -= weight * at(others_score)[j]
            left = max(left, NOT_SEPARABLE * known)
        at(values)[i] = seen / left
        at(variances)[i] = max((sum_[NIS] - seen * at(values)[i]) / max(sum_[DOF], 1.0), 1.0) / left
        if i == q - 1:
            least *= grown * grown
        at(sigmas)[i] = 0.0 if left < least else fabs(at(values)[i]) / sqrt(at(variances)[i])
    return values, variances, sigmas


def products_with_last(ids, errors, last_ids, last_errors, double longest):
    cdef Array which = integers(ids), known = integers(last_ids), now = doubles(errors), last = doubles(last_errors)
    cdef Py_ssize_t m = length(which), l = length(known), i, j, again = 0
    cdef Array bounded = matrix(m, 2)
    cdef double* mine = at(bounded)
    cdef double size, product, total = 0.0
    for i in range(m):
        size = sqrt(at(now)[2 * i] ** 2 + at(now)[2 * i + 1] ** 2)
        size = longest / size if size > longest else 1.0
        mine[2 * i], mine[2 * i + 1] = size * at(now)[2 * i], size * at(now)[2 * i + 1]
        for j in range(l):
            if at_integers(known)[j] == at_integers(which)[i]:
                product = mine[2 * i] * at(last)[2 * j] + mine[2 * i + 1] * at(last)[2 * j + 1]
                if product == product:  # not NaN
                    total += product
                    again += 1
                break
    return bounded, total, again
