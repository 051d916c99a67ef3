# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Twins of `ekf.motion`, `ekf.steady_rate`, `ekf.effects_by_place`, `ekf.predict`, `ekf.step_record`,
`effects.fading` and `effects.learned.drives` for the samples of a block."""

from libc.math cimport cos, exp, sin, sqrt

import numpy as np

TWINS = (
    'fading_memory', 'interpolate', 'intervals', 'low_pass', 'mean_at_end', 'path_in_block', 'rate_scatter', 'step_numbers'
)


cdef class Track:
    """A signal that is interpolated linearly at times that increase; constant before and after its samples."""

    cdef list times_ns, values
    cdef long long start_ns
    cdef Py_ssize_t last, j
    cdef double low, high, value, end, slope

    def __cinit__(self, long long start_ns, list times_ns, list values):
        self.start_ns, self.times_ns, self.values = start_ns, times_ns, values
        self.last, self.j = len(times_ns) - 1, 0
        self.low, self.value = <double>(<long long>times_ns[0] - start_ns), values[0]
        self.high, self.end, self.slope = self.low, self.value, 0.0
        if self.last > 0:
            self.move(1)

    cdef void move(self, Py_ssize_t j):
        """Begin with the interval that ends at a sample."""
        self.low, self.value = self.high, self.end
        self.high, self.end = <double>(<long long>self.times_ns[j] - self.start_ns), self.values[j]
        self.slope = (self.end - self.value) / (self.high - self.low)
        self.j = j

    cdef double at(self, double offset_ns):
        while offset_ns >= self.high and self.j < self.last:
            self.move(self.j + 1)
        if offset_ns <= self.low:
            return self.value
        if offset_ns >= self.high:
            return self.end
        return self.slope * (offset_ns - self.low) + self.value


def intervals(list times_ns, list nodes, list wheels_ns, list travelled_m, list turned_rad):
    cdef Py_ssize_t n = len(times_ns) - 1, k, i
    cdef tuple node
    cdef long long start_ns = times_ns[0]
    cdef double offset_ns, earlier_ns = 0.0, scatter = 0.0, step
    cdef double here[6]
    cdef double before[6]
    for i in range(6):
        before[i] = 0.0
    arrays = (np.empty(n), np.empty(n), np.empty((n, 3)), np.empty(n), np.empty((n, 3)))
    by_wheels = (np.zeros(n), np.zeros(n))
    cdef double[::1] middle = arrays[0], dt = arrays[1], acceleration = arrays[3]
    cdef double[::1] distance = by_wheels[0], turn = by_wheels[1]
    cdef double[:, ::1] rate = arrays[2], force = arrays[4]
    cdef bint has_wheels = len(wheels_ns) > 1
    cdef double way_m = 0.0, way_before_m = 0.0, angle_rad = 0.0, angle_before_rad = 0.0
    cdef Track travelled = None, turned = None
    if has_wheels:
        travelled, turned = Track(start_ns, wheels_ns, travelled_m), Track(start_ns, wheels_ns, turned_rad)
    for k in range(n + 1):
        offset_ns = <double>(<long long>times_ns[k] - start_ns)
        if has_wheels:
            way_m, angle_rad = travelled.at(offset_ns), turned.at(offset_ns)
            if k > 0:
                distance[k - 1], turn[k - 1] = way_m - way_before_m, angle_rad - angle_before_rad
            way_before_m, angle_before_rad = way_m, angle_rad
        node = nodes[k]
        for i in range(6):
            here[i] = node[i]
        if k > 0:
            middle[k - 1] = 0.5 * (offset_ns + earlier_ns)
            dt[k - 1] = (offset_ns - earlier_ns) / 1e9
            acceleration[k - 1] = (here[2] - before[2]) / dt[k - 1]
            for i in range(3):
                rate[k - 1, i] = 0.5 * (here[i] + before[i])
                force[k - 1, i] = 0.5 * (here[3 + i] + before[3 + i])
                if 1 < k < n:  # between samples, the ends of the block are none
                    step = here[3 + i] - before[3 + i]
                    scatter += step * step
        for i in range(6):
            before[i] = here[i]
        earlier_ns = offset_ns
    return (*arrays, 0.5 * scatter / (n - 2) if n > 2 else float('nan'), *by_wheels)


def interpolate(long long start_ns, const double[:] offsets_ns, list times_ns, list values):
    cdef Py_ssize_t k
    cdef Track track = Track(start_ns, times_ns, values)
    result = np.empty(offsets_ns.shape[0])
    cdef double[::1] out = result
    for k in range(offsets_ns.shape[0]):
        out[k] = track.at(offsets_ns[k])
    return result


def path_in_block(
    double x_m, double y_m, double yaw_rad, const double[:] rate_rad_s, const double[:] dt_s, const double[:] distance_m
):
    cdef Py_ssize_t n = dt_s.shape[0], k
    cdef double turn, ahead_x, ahead_y
    heading_rad, position_m = np.empty(n), np.empty((n, 2))
    cdef double[::1] heading = heading_rad
    cdef double[:, ::1] position = position_m
    for k in range(n):
        turn = rate_rad_s[k] * dt_s[k]
        yaw_rad += turn
        heading[k] = yaw_rad - 0.5 * turn
        ahead_x, ahead_y = cos(heading[k]) * distance_m[k], sin(heading[k]) * distance_m[k]
        x_m += ahead_x
        y_m += ahead_y
        position[k, 0], position[k, 1] = x_m - 0.5 * ahead_x, y_m - 0.5 * ahead_y
    return heading_rad, position_m


def rate_scatter(const double[:] rate_rad_s, const double[:] dt_s):
    cdef Py_ssize_t n = dt_s.shape[0], k
    cdef double turned = 0.0, duration = 0.0, steps = 0.0, bends = 0.0, step = 0.0, before, inside = 0.0, square = 0.0
    for k in range(n):
        turned += rate_rad_s[k] * dt_s[k]
        duration += dt_s[k]
        if k > 0:
            before, step = step, rate_rad_s[k] - rate_rad_s[k - 1]
            steps += step * step
            if k > 1:
                bends += (step - before) * (step - before)
        if 0 < k < n - 1:
            inside += dt_s[k]
    if n > 2:
        inside /= n - 2
        for k in range(1, n - 1):
            square += (dt_s[k] - inside) * (dt_s[k] - inside)
    return (
        turned / duration,
        steps / (n - 1) * duration / n if n > 1 else 0.0,
        bends / (n - 2) * duration / n if n > 2 else 0.0,
        sqrt(square / (n - 2)) / inside if n > 4 else 0.0,
    )


def mean_at_end(const double[:] values, const double[:] dt_s, double length_s):
    cdef Py_ssize_t k = dt_s.shape[0] - 1
    cdef double left_s = max(length_s, dt_s[k]), total = 0.0, duration_s = 0.0, within_s
    while k >= 0 and left_s > 0.0:
        within_s = min(dt_s[k], left_s)
        total += within_s * values[k]
        duration_s += within_s
        left_s -= dt_s[k]
        k -= 1
    return total / duration_s


def fading_memory(const double[:] drive, const double[:] dt_s, const double[:] tau_s, const double[:] start):
    cdef Py_ssize_t n = dt_s.shape[0], q = tau_s.shape[0], k, i
    cdef double end_s, kept
    solution, grown = np.empty((n + 1, q)), np.empty((n + 1, q))
    cdef double[:, ::1] h = solution, growth = grown
    for i in range(q):
        end_s, h[0, i], growth[0, i] = 0.0, start[i], 1.0
        for k in range(n):
            end_s += dt_s[k]
            kept = exp(-dt_s[k] / tau_s[i])
            h[k + 1, i] = drive[k] + kept * (h[k, i] - drive[k])
            growth[k + 1, i] = exp(end_s / tau_s[i])
    return solution, grown


def low_pass(const double[:, :] drive, const double[:, :] kept, start):
    cdef Py_ssize_t n = drive.shape[0], q = drive.shape[1], k, i
    solution = np.empty((n + 1, q))
    cdef double[:, ::1] h = solution
    solution[0] = start
    for k in range(n):
        for i in range(q):
            h[k + 1, i] = drive[k, i] + kept[k, i] * (h[k, i] - drive[k, i])
    return solution


def step_numbers(
    before, predicted, after, const double[:] dt_s, correction, const double[:, :] rate_rad_s, const double[:] euler_rad
):
    cdef const double[:] earlier = before.mean, expected = predicted.mean, mean = after.mean
    cdef const double[:, :] P_expected = predicted.covariance, P = after.covariance
    cdef const double[:, :] by_values = correction.by_values
    cdef const double[:] correction_rad_s = correction.rate_rad_s
    cdef Py_ssize_t n = dt_s.shape[0], k = after.coefficient_count, r = 9 + k, i, j
    cdef double corrected = 0.0, turned = 0.0
    arrays = (np.empty(r), np.empty(1 + k), np.empty(1 + k), np.zeros(k))
    cdef double[::1] std = arrays[0], change = arrays[1], change_variance = arrays[2], columns = arrays[3]
    for i in range(r):
        std[i] = sqrt(P[i, i])
    for i in range(1 + k):
        change[i] = mean[8 + i] - expected[8 + i]
        change_variance[i] = P_expected[8 + i, 8 + i] - P[8 + i, 8 + i]
    for j in range(n):
        corrected += dt_s[j] * correction_rad_s[j]
        turned += dt_s[j] * rate_rad_s[j, 2]
        for i in range(k):
            columns[i] += dt_s[j] * by_values[j, i]
    for i in range(k):
        corrected += columns[i] * (mean[9 + i] - earlier[9 + i])
    return (*arrays, corrected, euler_rad[2] - earlier[5] - turned)
