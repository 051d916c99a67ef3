# cython: language_level=3
"""Positive definite matrices, for the kernels of updates and watches."""

from libc.math cimport sqrt

from gyrocal_ros.kernels.arrays cimport clear


cdef inline bint whiten(double* S, double* W, Py_ssize_t q) noexcept nogil:
    """Write L^-1 of a covariance (q, q), which is overwritten; return False where it has none.

    Rows of S become rows of L^T from above, and the same steps turn the unit matrix into L^-1.
    """
    cdef Py_ssize_t i, j, l
    cdef double pivot, factor
    cdef double* row
    cdef double* white
    clear(W, q * q)
    for i in range(q):
        W[i * (q + 1)] = 1.0
    for j in range(q):
        row, white = S + j * q, W + j * q
        pivot = row[j]
        if not pivot > 0.0:
            return False
        pivot = 1.0 / sqrt(pivot)
        for l in range(j, q):
            row[l] *= pivot
        for l in range(j + 1):
            white[l] *= pivot
        for i in range(j + 1, q):
            factor = row[i]
            for l in range(i, q):
                S[i * q + l] -= factor * row[l]
            for l in range(j + 1):
                W[i * q + l] -= factor * white[l]
    return True


cdef inline bint invert(double* S, double* inverse, Py_ssize_t q) noexcept nogil:
    """Write the inverse of a covariance (q, q), which is overwritten; return False where it has none."""
    cdef Py_ssize_t i, j, l
    cdef double factor
    if not whiten(S, inverse, q):
        return False
    for i in range(q):
        for l in range(i + 1):
            S[i * q + l] = 0.0
    for j in range(q):
        for i in range(j + 1):
            factor = inverse[j * q + i]
            for l in range(i + 1):
                S[i * q + l] += factor * inverse[j * q + l]
    for i in range(q):
        for l in range(i + 1):
            inverse[i * q + l] = inverse[l * q + i] = S[i * q + l]
    return True
