# cython: language_level=3
"""Arrays by the C interface of NumPy.

A step of the filter passes some two hundred small arrays to kernels and gets some hundred new ones: as memory
views, or by the functions of NumPy, they would cost more than the sums.
"""

from libc.string cimport memset

cimport numpy as cnp
from numpy cimport ndarray as Array

cdef extern from "numpy/arrayobject.h":
    bint PyArray_CheckExact(object values)


cdef inline Array contiguous(object values, int kind):
    """Return numbers as a contiguous array of a kind of NumPy, a copy only where they are not one already."""
    if (
        PyArray_CheckExact(values)
        and cnp.PyArray_TYPE(<Array>values) == kind
        and cnp.PyArray_IS_C_CONTIGUOUS(<Array>values)
    ):
        return <Array>values
    return <Array>cnp.PyArray_FROM_OTF(values, kind, cnp.NPY_ARRAY_CARRAY_RO)


cdef inline Array doubles(object values):
    """Return numbers as a contiguous array of float64."""
    return contiguous(values, cnp.NPY_DOUBLE)


cdef inline Array integers(object values):
    """Return numbers as a contiguous array of int64."""
    return contiguous(values, cnp.NPY_INT64)


cdef inline double* at(Array values) noexcept:
    """Return where the numbers of a contiguous array of float64 are; the array has to outlive that."""
    return <double*>cnp.PyArray_DATA(values)


cdef inline long* at_integers(Array values) noexcept:
    """Return the same of an array of int64."""
    return <long*>cnp.PyArray_DATA(values)


cdef inline Py_ssize_t length(Array values, int axis = 0) noexcept:
    """Return the length of an axis."""
    return cnp.PyArray_DIM(values, axis)


cdef inline Array vector(Py_ssize_t n):
    """Return a new array (n,), as those below, whose numbers are not set."""
    cdef cnp.npy_intp shape[1]
    shape[0] = n
    return <Array>cnp.PyArray_EMPTY(1, shape, cnp.NPY_DOUBLE, 0)


cdef inline Array matrix(Py_ssize_t n, Py_ssize_t m):
    cdef cnp.npy_intp shape[2]
    shape[0], shape[1] = n, m
    return <Array>cnp.PyArray_EMPTY(2, shape, cnp.NPY_DOUBLE, 0)


cdef inline Array cube(Py_ssize_t n, Py_ssize_t m, Py_ssize_t l):
    cdef cnp.npy_intp shape[3]
    shape[0], shape[1], shape[2] = n, m, l
    return <Array>cnp.PyArray_EMPTY(3, shape, cnp.NPY_DOUBLE, 0)


cdef inline Array fourfold(Py_ssize_t n, Py_ssize_t m, Py_ssize_t l, Py_ssize_t k):
    cdef cnp.npy_intp shape[4]
    shape[0], shape[1], shape[2], shape[3] = n, m, l, k
    return <Array>cnp.PyArray_EMPTY(4, shape, cnp.NPY_DOUBLE, 0)


cdef inline Array indices(Py_ssize_t n):
    """Return a new array (n,) of int64."""
    cdef cnp.npy_intp shape[1]
    shape[0] = n
    return <Array>cnp.PyArray_EMPTY(1, shape, cnp.NPY_INT64, 0)


cdef inline Array copied(Array values):
    """Return a copy."""
    return <Array>cnp.PyArray_NewCopy(values, cnp.NPY_CORDER)


cdef inline void clear(double* values, Py_ssize_t count) noexcept nogil:
    """Set numbers to zero."""
    memset(values, 0, count * sizeof(double))
