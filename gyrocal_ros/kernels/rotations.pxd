# cython: language_level=3
"""Rotations, for the kernels of motion and cameras."""

from libc.math cimport cos, sin


cdef inline void rotate(const double* euler, double[3][3] R) noexcept nogil:
    """Write the matrix of roll, pitch and yaw."""
    cdef double cr = cos(euler[0]), sr = sin(euler[0]), cp = cos(euler[1]), sp = sin(euler[1])
    cdef double cy = cos(euler[2]), sy = sin(euler[2])
    R[0][0], R[0][1], R[0][2] = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
    R[1][0], R[1][1], R[1][2] = sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr
    R[2][0], R[2][1], R[2][2] = -sp, cp * sr, cp * cr
