# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Twins of `ekf.state.layout`, `ekf.features.anchors`, `ekf.features.feature_noise`, `ekf.features.known_depth`, `ekf.features.landmarks`, `ekf.image_update`,
`ekf.features.near_features`, `ekf.features.repeated_errors` and `ekf.features.sliding`, which explain the equations."""

from libc.math cimport fabs, sqrt
from libc.string cimport memcpy

cimport numpy as cnp
from numpy cimport ndarray as Array

from gyrocal_ros.kernels.arrays cimport (
    at, at_integers, clear, copied, cube, doubles, indices, integers, length, matrix, vector
)

cnp.import_array()

TWINS = (
    'changed_depths',
    'compared_depths',
    'features_seen',
    'hardly_known',
    'ids_by_way',
    'known_anchored',
    'learned_noise',
    'match_ids',
    'matches_counted',
    'motion_in_image',
    'noise_dominated',
    'scaled_noise',
    'shared_ways',
    'shift',
)

cdef Py_ssize_t COEFFICIENTS_START = 9


cdef Array first_of(Array values, Py_ssize_t count):
    """Return the first rows of an array."""
    return values if count == length(values) else values[:count]


cdef void take(const double* rows_of, const long* rows, Py_ssize_t m, Py_ssize_t width, double* taken) noexcept nogil:
    cdef Py_ssize_t f
    for f in range(m):
        memcpy(taken + f * width, rows_of + rows[f] * width, width * sizeof(double))


def features_seen(state, rows):
    landmarks = state.landmarks
    anchors = landmarks.anchors
    cdef Array mean = doubles(state.mean), which = integers(rows), anchor_rows = integers(landmarks.anchor_rows)
    cdef Array R_wc = doubles(anchors.R_wc), p_wc = doubles(anchors.p_wc)
    cdef Array by_values = doubles(anchors.by_values), by_candidates = doubles(anchors.by_candidates)
    cdef Py_ssize_t M = length(anchor_rows), m = length(which), k = length(by_values, 2), c = length(by_candidates, 2)
    cdef Py_ssize_t robot = COEFFICIENTS_START + <Py_ssize_t>state.coefficient_count, f, i
    cdef Py_ssize_t start = robot + 3 * M, count = length(mean), place
    cdef Array parameters = matrix(m, 3), R = cube(m, 3, 3), p = matrix(m, 3)
    cdef Array own_values = cube(m, 3, k), own_candidates = cube(m, 3, c)
    cdef const double* x = at(mean)
    cdef const long* row = at_integers(which)
    cdef const long* anchor = at_integers(anchor_rows)
    cdef double* position = at(p)
    take(x + robot, row, m, 3, at(parameters))
    take(at(R_wc), row, m, 9, at(R))
    take(at(p_wc), row, m, 3, position)
    take(at(by_values), row, m, 3 * k, at(own_values))
    take(at(by_candidates), row, m, 3 * c, at(own_candidates))
    if count > start:
        for f in range(m):
            place = anchor[row[f]]
            if place >= 0:
                for i in range(3):
                    position[3 * f + i] = x[start + 3 * place + i]
    return parameters, R, p, own_values, own_candidates


def hardly_known(state, rows, double least):
    cdef Array P = doubles(state.covariance), which = integers(rows), uncertain = indices(length(which))
    cdef Py_ssize_t n = length(P), start = COEFFICIENTS_START + <Py_ssize_t>state.coefficient_count + 2, f, count = 0
    for f in range(length(which)):
        if at(P)[(start + 3 * at_integers(which)[f]) * (n + 1)] > least * least:
            at_integers(uncertain)[count] = f
            count += 1
    return first_of(uncertain, count)


def noise_dominated(distances, noise_share, unmoved, double least):
    cdef Array squares = doubles(distances), shares = doubles(noise_share)
    cdef Array flags = cnp.PyArray_GETCONTIGUOUS(unmoved)
    cdef const unsigned char* stays = <const unsigned char*>cnp.PyArray_DATA(flags)
    cdef Py_ssize_t f, count = 0
    cdef Array chosen = vector(length(squares))
    for f in range(length(squares)):
        if at(shares)[f] > least and not stays[f]:
            at(chosen)[count] = at(squares)[f]
            count += 1
    return first_of(chosen, count)


def ids_by_way(state, camera_m, double least):
    landmarks = state.landmarks
    cdef Array mean = doubles(state.mean), ids = integers(landmarks.ids), seen_ns = integers(landmarks.last_seen_ns)
    cdef Array anchor_rows = integers(landmarks.anchor_rows), constant = doubles(landmarks.anchors.p_wc)
    cdef Array camera = doubles(camera_m)
    cdef Py_ssize_t M = length(ids), robot = COEFFICIENTS_START + <Py_ssize_t>state.coefficient_count, f, i
    cdef Py_ssize_t in_view = 0, count = 0, start = robot + 3 * M
    cdef long t_ns = state.t_ns
    cdef double way, square
    cdef const double* x = at(mean)
    cdef const double* anchor
    cdef const double* here = at(camera)
    cdef Array seen = indices(M), far = indices(M)
    for f in range(M):
        if at_integers(seen_ns)[f] != t_ns:
            continue
        at_integers(seen)[in_view] = at_integers(ids)[f]
        in_view += 1
        anchor = at(constant) + 3 * f
        if at_integers(anchor_rows)[f] >= 0:
            anchor = x + start + 3 * at_integers(anchor_rows)[f]
        square = 0.0
        for i in range(3):
            way = anchor[i] - here[i]
            square += way * way
        if sqrt(square) * x[robot + 3 * f + 2] > least:
            at_integers(far)[count] = at_integers(ids)[f]
            count += 1
    return first_of(seen, in_view), first_of(far, count)


def known_anchored(state, double known):
    cdef Array mean = doubles(state.mean), P = doubles(state.covariance)
    cdef Array anchor_rows = integers(state.landmarks.anchor_rows), rows = indices(length(anchor_rows))
    cdef Py_ssize_t n = length(mean), depth = COEFFICIENTS_START + <Py_ssize_t>state.coefficient_count + 2, f, count = 0
    for f in range(length(anchor_rows)):
        if at_integers(anchor_rows)[f] >= 0 and sqrt(at(P)[depth * (n + 1)]) < known * fabs(at(mean)[depth]):
            at_integers(rows)[count] = f
            count += 1
        depth += 3
    return first_of(rows, count)


def learned_noise(
    weights,
    sums,
    rows,
    distances,
    noise_share,
    double prior,
    double min_factor,
    double max_error,
    double kept,
    double dof,
):
    cdef Array which = integers(rows), squares = doubles(distances), shares = doubles(noise_share)
    cdef Array new_weights = copied(doubles(weights)), new_sums = copied(doubles(sums))
    cdef Py_ssize_t m = length(which), f, row
    cdef double mean = 0.0, factor
    cdef Array errors = vector(m)
    cdef double* w = at(new_weights)
    cdef double* s = at(new_sums)
    cdef double* error = at(errors)
    for f in range(m):
        error[f] = at(shares)[f] * min(at(squares)[f] / dof, max_error) + 1.0 - at(shares)[f]
        mean += error[f]
    mean /= m
    for f in range(m):
        row = at_integers(which)[f]
        factor = max((prior + s[row]) / (prior + w[row]), min_factor)
        w[row] = kept * w[row] + 1.0
        s[row] = kept * s[row] + factor * error[f] / mean
    return new_weights, new_sums


def scaled_noise(typical, weights, sums, rows, double prior, double min_factor):
    cdef Array usual = doubles(typical), w = doubles(weights), s = doubles(sums), which = integers(rows)
    cdef Py_ssize_t m = length(which), f, i, row
    cdef double factor
    cdef Array noise = cube(m, 2, 2)
    for f in range(m):
        row = at_integers(which)[f]
        factor = max((prior + at(s)[row]) / (prior + at(w)[row]), min_factor)
        for i in range(4):
            at(noise)[4 * f + i] = factor * at(usual)[4 * f + i]
    return noise


def match_ids(ids, wanted):
    cdef Array of_map = integers(ids), of_image = integers(wanted)
    cdef Py_ssize_t M = length(of_map), m = length(of_image), f, place, count = 0
    cdef Array known = indices(m), found = indices(m)
    for f in range(m):
        for place in range(M):
            if at_integers(of_map)[place] == at_integers(of_image)[f]:
                at_integers(known)[count], at_integers(found)[count] = f, place
                count += 1
                break
    return first_of(known, count), first_of(found, count)


def motion_in_image(
    points_c, pixels, last_directions, last_pixels, rows, double focal_px, double min_depth
):
    cdef Array points = doubles(points_c), observed = doubles(pixels), which = integers(rows)
    cdef Array towards_before = doubles(last_directions), observed_before = doubles(last_pixels)
    cdef Py_ssize_t m = length(which), f, i, row
    cdef double expected, change, square, changes
    cdef Array directions = matrix(m, 2), moved_px = vector(m), changes_px2 = vector(m)
    cdef double* towards = at(directions)
    for f in range(m):
        row = at_integers(which)[f]
        square = changes = 0.0
        for i in range(2):
            towards[2 * f + i] = at(points)[3 * f + i] / max(at(points)[3 * f + 2], min_depth)
            expected = focal_px * (towards[2 * f + i] - at(towards_before)[2 * row + i])
            change = at(observed)[2 * f + i] - at(observed_before)[2 * row + i] - expected
            square += expected * expected
            changes += change * change
        at(moved_px)[f] = sqrt(square)
        at(changes_px2)[f] = 0.5 * changes
    return directions, moved_px, changes_px2


def matches_counted(
    last_seen_ns, rejections, last_pixels, last_directions, long t_ns, rows, accepted, pixels, directions
):
    cdef Array which = integers(rows), observed = doubles(pixels), expected = doubles(directions)
    cdef Array seen_ns = copied(integers(last_seen_ns)), misses = copied(integers(rejections))
    cdef Array at_pixels = copied(doubles(last_pixels)), towards = copied(doubles(last_directions))
    cdef Py_ssize_t f, i, row
    cdef Array good = cnp.PyArray_GETCONTIGUOUS(accepted)
    cdef const unsigned char* is_accepted = <const unsigned char*>cnp.PyArray_DATA(good)
    for f in range(length(which)):
        row = at_integers(which)[f]
        at_integers(misses)[row] = 0 if is_accepted[f] else at_integers(misses)[row] + 1
        if is_accepted[f]:
            at_integers(seen_ns)[row] = t_ns
        for i in range(2):
            at(at_pixels)[2 * row + i] = at(observed)[2 * f + i]
            at(towards)[2 * row + i] = at(expected)[2 * f + i]
    return seen_ns, misses, at_pixels, towards


def changed_depths(mean, Py_ssize_t first, rows, before, points_c, double least, double min_ahead):
    cdef Array after = doubles(mean), which = integers(rows), earlier = doubles(before), points = doubles(points_c)
    cdef Py_ssize_t m = length(which), f, count = 0
    cdef double change
    cdef Array chosen = indices(m), changes = vector(m)
    for f in range(m):
        change = at(after)[first + 3 * at_integers(which)[f] + 2] - at(earlier)[f]
        if fabs(change) > least and at(points)[3 * f + 2] > min_ahead:
            at_integers(chosen)[count], at(changes)[count] = f, change
            count += 1
    return first_of(chosen, count), first_of(changes, count)


def shift(covariance, sensitivity, places, causes, by_causes):
    cdef Array before = doubles(covariance), G = doubles(sensitivity), by = doubles(by_causes)
    cdef Array entries = integers(places), others = integers(causes)
    cdef Py_ssize_t n = length(before), c = length(G, 1), q = length(entries), p = length(others), i, j, l
    cdef double factor, total
    cdef Array after = copied(before), moved = copied(G)
    cdef const double* source
    cdef double* row
    for i in range(q):
        for l in range(p):
            factor = at(by)[i * p + l]
            source, row = at(before) + at_integers(others)[l] * n, at(after) + at_integers(entries)[i] * n
            for j in range(n):
                row[j] += factor * source[j]
            source, row = at(G) + at_integers(others)[l] * c, at(moved) + at_integers(entries)[i] * c
            for j in range(c):
                row[j] += factor * source[j]
    for j in range(n):
        row = at(after) + j * n
        for i in range(q):
            total = 0.0
            for l in range(p):
                total += row[at_integers(others)[l]] * at(by)[i * p + l]
            row[at_integers(entries)[i]] += total
    return after, moved


def shared_ways(state, rows, change, camera_m, double least):
    cdef Array mean = doubles(state.mean), which = integers(rows), changes = doubles(change), camera = doubles(camera_m)
    cdef Array anchor_rows = integers(state.landmarks.anchor_rows)
    cdef Py_ssize_t robot = COEFFICIENTS_START + <Py_ssize_t>state.coefficient_count, m = length(which), f, g, i, row
    cdef Py_ssize_t start = robot + 3 * length(anchor_rows), count = 0, anchors = 0, p
    cdef Array told = indices(m), way = matrix(m, 3), used = indices(m)
    cdef double* by = at(way)
    cdef long* anchor = at_integers(used)
    cdef const double* x = at(mean)
    cdef double square
    for f in range(m):
        row = at_integers(which)[f]
        if at_integers(anchor_rows)[row] < 0:
            continue
        square = 0.0
        for i in range(3):
            by[3 * count + i] = x[start + 3 * at_integers(anchor_rows)[row] + i] - at(camera)[i]
            square += by[3 * count + i] * by[3 * count + i]
        if sqrt(square) * x[robot + 3 * row + 2] > least:
            for i in range(3):
                by[3 * count + i] *= -(at(changes)[f] / square)
            at_integers(told)[count] = row
            count += 1
    for f in range(count):  # the anchors used, each once and in order
        row = at_integers(anchor_rows)[at_integers(told)[f]]
        g = anchors
        while g > 0 and anchor[g - 1] > row:
            g -= 1
        if g > 0 and anchor[g - 1] == row:
            continue
        for i in range(anchors, g, -1):
            anchor[i] = anchor[i - 1]
        anchor[g] = row
        anchors += 1
    p = 3 + 3 * anchors
    cdef Array causes = indices(p), by_causes = matrix(count, p)
    clear(at(by_causes), count * p)
    for i in range(3):
        at_integers(causes)[i] = i
        for g in range(anchors):
            at_integers(causes)[3 + 3 * g + i] = start + 3 * anchor[g] + i
    for f in range(count):
        for i in range(3):
            at(by_causes)[f * p + i] = -by[3 * f + i]
            for g in range(anchors):
                if anchor[g] == at_integers(anchor_rows)[at_integers(told)[f]]:
                    at(by_causes)[f * p + 3 + 3 * g + i] = by[3 * f + i]
    return first_of(told, count), first_of(way, count), causes, by_causes


def compared_depths(known_ids, known_depths, known_variances, state, double min_learned, double renewed):
    cdef Array known = integers(known_ids), old_depths = doubles(known_depths), old_variances = doubles(known_variances)
    cdef Array present = integers(state.landmarks.ids), mean = doubles(state.mean), P = doubles(state.covariance)
    cdef Py_ssize_t n = length(known), m = length(present), f, place
    cdef Py_ssize_t at_depth = COEFFICIENTS_START + <Py_ssize_t>state.coefficient_count + 2
    cdef double before, variance, learned, depth, now
    cdef Array surprises = vector(m), kept = vector(m), kept_variances = vector(m)
    for f in range(m):
        depth, now = at(mean)[at_depth + 3 * f], at(P)[(at_depth + 3 * f) * (length(mean) + 1)]
        before, variance = depth, now
        for place in range(n):
            if at_integers(known)[place] == at_integers(present)[f]:
                before, variance = at(old_depths)[place], at(old_variances)[place]
                break
        learned = variance - now
        at(surprises)[f] = (depth - before) ** 2 / learned if learned > min_learned * variance else -1.0
        if renewed * now < variance or now > variance:
            before, variance = depth, now
        at(kept)[f], at(kept_variances)[f] = before, variance
    return surprises, kept, kept_variances
