# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Twins of `ekf.feature_noise`, `ekf.known_depth`, `ekf.landmarks`, `ekf.image_update`, `ekf.repeated_errors` and
`ekf.sliding`, which explain the equations."""

from libc.math cimport fabs, sqrt

import numpy as np

TWINS = (
    'changed_depths',
    'compared_depths',
    'learned_noise',
    'match_ids',
    'matches_counted',
    'motion_in_image',
    'scaled_noise',
    'shift',
)


def learned_noise(
    const double[:] weights,
    const double[:] sums,
    const long[:] rows,
    const double[:] distances,
    const double[:] noise_share,
    double prior,
    double min_factor,
    double max_error,
    double kept,
    double dof,
):
    cdef Py_ssize_t m = rows.shape[0], f, row
    cdef double mean = 0.0, factor
    new_weights, new_sums = np.array(weights), np.array(sums)
    cdef double[::1] w = new_weights, s = new_sums, errors = np.empty(m)
    for f in range(m):
        errors[f] = noise_share[f] * min(distances[f] / dof, max_error) + 1.0 - noise_share[f]
        mean += errors[f]
    mean /= m
    for f in range(m):
        row = rows[f]
        factor = max((prior + sums[row]) / (prior + weights[row]), min_factor)
        w[row] = kept * weights[row] + 1.0
        s[row] = kept * sums[row] + factor * errors[f] / mean
    return new_weights, new_sums


def scaled_noise(
    const double[:, :, :] typical,
    const double[:] weights,
    const double[:] sums,
    const long[:] rows,
    double prior,
    double min_factor,
):
    cdef Py_ssize_t m = rows.shape[0], f, i, j
    cdef double factor
    result = np.empty((m, 2, 2))
    cdef double[:, :, ::1] noise = result
    for f in range(m):
        factor = max((prior + sums[rows[f]]) / (prior + weights[rows[f]]), min_factor)
        for i in range(2):
            for j in range(2):
                noise[f, i, j] = factor * typical[f, i, j]
    return result


def match_ids(const long[:] ids, const long[:] wanted):
    cdef Py_ssize_t M = ids.shape[0], m = wanted.shape[0], f, place, count = 0
    known, places = np.empty(m, np.int64), np.empty(m, np.int64)
    cdef long[::1] which = known, found = places
    for f in range(m):
        for place in range(M):
            if ids[place] == wanted[f]:
                which[count], found[count] = f, place
                count += 1
                break
    return known[:count], places[:count]


def motion_in_image(
    const double[:, :] points_c,
    const double[:, :] pixels,
    const double[:, :] last_directions,
    const double[:, :] last_pixels,
    const long[:] rows,
    double focal_px,
    double min_motion_px,
    double min_depth,
):
    cdef Py_ssize_t m = rows.shape[0], f, i, row
    cdef double expected, change, square, changes
    directions, unmoved, changes_px2 = np.empty((m, 2)), np.empty(m, bool), np.empty(m)
    cdef double[:, ::1] towards = directions
    cdef unsigned char[::1] is_unmoved = unmoved.view(np.uint8)
    cdef double[::1] out = changes_px2
    for f in range(m):
        row = rows[f]
        square = changes = 0.0
        for i in range(2):
            towards[f, i] = points_c[f, i] / max(points_c[f, 2], min_depth)
            expected = focal_px * (towards[f, i] - last_directions[row, i])
            change = pixels[f, i] - last_pixels[row, i] - expected
            square += expected * expected
            changes += change * change
        is_unmoved[f] = sqrt(square) < min_motion_px
        out[f] = 0.5 * changes
    return directions, unmoved, changes_px2


def matches_counted(
    last_seen_ns, rejections, last_pixels, last_directions, long t_ns, const long[:] rows, accepted, pixels, directions
):
    cdef Py_ssize_t m = rows.shape[0], f, i, row
    arrays = (last_seen_ns.copy(), rejections.copy(), last_pixels.copy(), last_directions.copy())
    cdef long[::1] seen_ns = arrays[0], misses = arrays[1]
    cdef double[:, ::1] at = arrays[2], towards = arrays[3]
    cdef const unsigned char[:] is_accepted = accepted.view(np.uint8)
    cdef const double[:, :] observed = pixels, expected = directions
    for f in range(m):
        row = rows[f]
        misses[row] = 0 if is_accepted[f] else misses[row] + 1
        if is_accepted[f]:
            seen_ns[row] = t_ns
        for i in range(2):
            at[row, i] = observed[f, i]
            towards[row, i] = expected[f, i]
    return arrays


def changed_depths(
    const double[:] mean,
    Py_ssize_t first,
    const long[:] rows,
    const double[:] before,
    const double[:, :] points_c,
    double least,
    double min_ahead,
):
    cdef Py_ssize_t m = rows.shape[0], f, count = 0
    cdef double change
    chosen, changes = np.empty(m, np.int64), np.empty(m)
    cdef long[::1] which = chosen
    cdef double[::1] by = changes
    for f in range(m):
        change = mean[first + 3 * rows[f] + 2] - before[f]
        if fabs(change) > least and points_c[f, 2] > min_ahead:
            which[count], by[count] = f, change
            count += 1
    return chosen[:count], changes[:count]


def shift(
    const double[:, ::1] covariance,
    const double[:, ::1] sensitivity,
    const long[:] places,
    const long[:] causes,
    const double[:, :] by_causes,
):
    cdef Py_ssize_t n = covariance.shape[0], c = sensitivity.shape[1], q = places.shape[0], p = causes.shape[0]
    cdef Py_ssize_t i, j, l, place
    cdef double factor, total
    arrays = (np.array(covariance), np.array(sensitivity))
    cdef double[:, ::1] P = arrays[0], X = arrays[1]
    for i in range(q):
        place = places[i]
        for l in range(p):
            factor = by_causes[i, l]
            for j in range(n):
                P[place, j] += factor * covariance[causes[l], j]
            for j in range(c):
                X[place, j] += factor * sensitivity[causes[l], j]
    for j in range(n):
        for i in range(q):
            total = 0.0
            for l in range(p):
                total += P[j, causes[l]] * by_causes[i, l]
            P[j, places[i]] += total
    return arrays


def compared_depths(
    const long[:] known_ids,
    const double[:] known_depths,
    const double[:] known_variances,
    const long[:] ids,
    const double[:] depths,
    const double[:] variances,
    double min_learned,
    double renewed,
):
    cdef Py_ssize_t n = known_ids.shape[0], m = ids.shape[0], f, place
    cdef double before, variance, learned
    arrays = (np.empty(m), np.empty(m), np.empty(m))
    cdef double[::1] surprises = arrays[0], kept = arrays[1], kept_variances = arrays[2]
    for f in range(m):
        before, variance = depths[f], variances[f]
        for place in range(n):
            if known_ids[place] == ids[f]:
                before, variance = known_depths[place], known_variances[place]
                break
        learned = variance - variances[f]
        surprises[f] = (depths[f] - before) ** 2 / learned if learned > min_learned * variance else -1.0
        if renewed * variances[f] < variance or variances[f] > variance:
            before, variance = depths[f], variances[f]
        kept[f], kept_variances[f] = before, variance
    return arrays
