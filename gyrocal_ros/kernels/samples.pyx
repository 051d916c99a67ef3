# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Twins of `ekf.intervals`, `model.faulty_readings`, `ekf.equations.steady_rate`, `ekf.state.columns`, `ekf.equations.effects_by_place`,
`ekf.equations.predict`, `ekf.history.step_record`, `effects.fading`, `effects.learned.curve` and `effects.learned.drives` for the
samples of a block."""

from libc.math cimport M_PI, cos, exp, fabs, isnan, sin, sqrt

cimport numpy as cnp
from numpy cimport ndarray as Array

import numpy as np

from gyrocal_ros.kernels.arrays cimport at, clear, doubles, length, matrix, vector

cnp.import_array()

TWINS = (
    'cosines',
    'fading_memory',
    'gained',
    'interpolate',
    'intervals',
    'low_pass',
    'mean_at_end',
    'pass_usual',
    'path_in_block',
    'rate_scatter',
    'step_numbers',
    'usual_interval_ns',
    'way_and_turn',
)


# As in `ekf.intervals` and in `model.faulty_readings`.
cdef long long PAUSE_NS = 1_000_000_000
cdef double MAX_ACCELERATION_RAD_S2 = 40.0, MIN_JUMP_RAD_S = 0.2, ROUGH_STEPS = 10.0, STEP_MEMORY = 0.02
cdef double MAX_REPEATED_SHARE = 0.02
cdef Py_ssize_t MIN_READINGS = 200


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


cdef Py_ssize_t place(list times_ns, long long t_ns, bint right):
    """Return where a time belongs among increasing ones, behind equal ones or before them."""
    cdef Py_ssize_t low = 0, high = len(times_ns), middle
    cdef long long here_ns
    while low < high:
        middle = (low + high) // 2
        here_ns = times_ns[middle]
        if here_ns < t_ns or (right and here_ns == t_ns):
            low = middle + 1
        else:
            high = middle
    return low


cdef void read(object sample, double* values):
    """Write rates and specific force (6,) of an IMU sample."""
    cdef tuple rate = sample.rate_rad_s, force = sample.specific_force_m_s2
    cdef Py_ssize_t i
    for i in range(3):
        values[i], values[3 + i] = rate[i], force[i]


cdef void read_at(list imu_ns, list imu, long long t_ns, double* values):
    """Write the same at a time, interpolated linearly; without turning in a pause."""
    cdef Py_ssize_t after = place(imu_ns, t_ns, False), count = len(imu), i
    cdef double earlier[6]
    cdef double part
    cdef long long before_ns, interval_ns
    read(imu[min(after, count - 1)], values)
    if after == 0 or after == count or <long long>imu_ns[after] == t_ns:
        return
    before_ns = imu_ns[after - 1]
    interval_ns = <long long>imu_ns[after] - before_ns
    read(imu[after - 1], earlier)
    part = <double>(t_ns - before_ns) / <double>interval_ns
    for i in range(6):
        if interval_ns <= PAUSE_NS:
            values[i] = earlier[i] + part * (values[i] - earlier[i])
        else:
            values[i] = 0.0 if i < 3 else earlier[i]


def intervals(
    list imu_ns,
    list imu,
    long long start_ns,
    long long end_ns,
    double running_s,
    double lead_rad_s,
    list wheels_ns,
    list travelled_m,
    list turned_rad,
):
    cdef Py_ssize_t first = place(imu_ns, start_ns, True), n = place(imu_ns, end_ns, False) - first + 1, k, i
    cdef double offset_ns, earlier_ns = 0.0, scatter = 0.0, step
    cdef double here[6]
    cdef double before[6]
    cdef Array middle_ns = vector(n), dt_s = vector(n), rates = matrix(n, 3), accelerations = vector(n), forces = matrix(n, 3)
    cdef Array ways = vector(n), turns = vector(n), speeds = vector(n), time_s = vector(n)
    cdef double* dt = at(dt_s)
    cdef double* rate = at(rates)
    cdef double* force = at(forces)
    cdef double* distance = at(ways)
    cdef double* turn = at(turns)
    clear(before, 6)
    clear(distance, n)
    clear(turn, n)
    cdef bint has_wheels = len(wheels_ns) > 1
    cdef double way_m = 0.0, way_before_m = 0.0, angle_rad = 0.0, angle_before_rad = 0.0
    cdef Track travelled = None, turned = None
    if has_wheels:
        travelled, turned = Track(start_ns, wheels_ns, travelled_m), Track(start_ns, wheels_ns, turned_rad)
    for k in range(n + 1):
        if 0 < k < n:
            offset_ns = <double>(<long long>imu_ns[first + k - 1] - start_ns)
            read(imu[first + k - 1], here)
        else:
            offset_ns = <double>(end_ns - start_ns) if k > 0 else 0.0
            read_at(imu_ns, imu, end_ns if k > 0 else start_ns, here)
        if has_wheels:
            way_m, angle_rad = travelled.at(offset_ns), turned.at(offset_ns)
            if k > 0:
                distance[k - 1], turn[k - 1] = way_m - way_before_m, angle_rad - angle_before_rad
            way_before_m, angle_before_rad = way_m, angle_rad
        if k > 0:
            at(middle_ns)[k - 1] = 0.5 * (offset_ns + earlier_ns)
            at(time_s)[k - 1] = running_s + at(middle_ns)[k - 1] / 1e9
            dt[k - 1] = (offset_ns - earlier_ns) / 1e9
            at(speeds)[k - 1] = distance[k - 1] / dt[k - 1]
            at(accelerations)[k - 1] = (here[2] - before[2]) / dt[k - 1]
            for i in range(3):
                rate[3 * (k - 1) + i] = 0.5 * (here[i] + before[i])
                force[3 * (k - 1) + i] = 0.5 * (here[3 + i] + before[3 + i])
                if 1 < k < n:  # between samples, the ends of the block are none
                    step = here[3 + i] - before[3 + i]
                    scatter += step * step
            rate[3 * (k - 1) + 2] -= lead_rad_s
        for i in range(6):
            before[i] = here[i]
        earlier_ns = offset_ns
    scatter = 0.5 * scatter / (n - 2) if n > 2 else float('nan')
    return middle_ns, time_s, dt_s, rates, accelerations, forces, scatter, ways, turns, speeds


def usual_interval_ns(list times_ns, Py_ssize_t first, double usual_ns):
    cdef Py_ssize_t i
    cdef double longer_ns
    for i in range(first, len(times_ns)):
        longer_ns = <double>(<long long>times_ns[i] - <long long>times_ns[i - 1]) - usual_ns
        usual_ns += longer_ns * (0.001 if longer_ns > 0.0 else 0.2)
    return usual_ns


def pass_usual(usual, list samples, Py_ssize_t first):
    cdef object last = usual.last, sample
    cdef Py_ssize_t passed = usual.passed, repeated = usual.repeated, i = first
    cdef double mean_step = usual.mean_step_rad_s, largest = usual.largest_rad_s, z, before_z = 0.0, step
    cdef long long t_ns, before_ns = 0
    cdef tuple rate, before = None
    cdef bint repeats
    if last is not None:
        before, before_ns = last.rate_rad_s, last.t_ns
        before_z = before[2]
    for i in range(first, len(samples) + 1):
        if i == len(samples):
            break
        sample = samples[i]
        rate, t_ns = sample.rate_rad_s, sample.t_ns
        z = rate[2]
        if before is not None:
            step, repeats = fabs(z - before_z), rate == before
            if t_ns <= before_ns:
                break
            if step >= MIN_JUMP_RAD_S and step > max(
                MAX_ACCELERATION_RAD_S2 * (<double>(t_ns - before_ns) / 1e9), ROUGH_STEPS * mean_step
            ):
                break
            if repeats and passed > MIN_READINGS and repeated < MAX_REPEATED_SHARE * passed and fabs(z) < largest:
                break
            mean_step += max(STEP_MEMORY, 1.0 / passed) * (step - mean_step)
            repeated += repeats
        if fabs(z) > largest:
            largest = fabs(z)
        passed += 1
        before, before_ns, before_z = rate, t_ns, z
    return i, passed, repeated, mean_step, largest


def interpolate(long long start_ns, offsets_ns, list times_ns, list values):
    cdef Array offsets = doubles(offsets_ns)
    cdef Py_ssize_t n = length(offsets), k
    cdef Track track = Track(start_ns, times_ns, values)
    cdef Array result = vector(n)
    for k in range(n):
        at(result)[k] = track.at(at(offsets)[k])
    return result


def path_in_block(mean, rate_rad_s, dt_s, distance_m):
    cdef Array x = doubles(mean), rates = doubles(rate_rad_s), dt = doubles(dt_s), distance = doubles(distance_m)
    cdef Py_ssize_t n = length(dt), k
    cdef double x_m = at(x)[0], y_m = at(x)[1], yaw_rad = at(x)[5], turn, ahead_x, ahead_y
    cdef Array heading_rad = vector(n), position_m = matrix(n, 2)
    cdef double* heading = at(heading_rad)
    for k in range(n):
        turn = at(rates)[3 * k + 2] * at(dt)[k]
        yaw_rad += turn
        heading[k] = yaw_rad - 0.5 * turn
        ahead_x, ahead_y = cos(heading[k]) * at(distance)[k], sin(heading[k]) * at(distance)[k]
        x_m += ahead_x
        y_m += ahead_y
        at(position_m)[2 * k], at(position_m)[2 * k + 1] = x_m - 0.5 * ahead_x, y_m - 0.5 * ahead_y
    return heading_rad, position_m


def way_and_turn(rate_rad_s, dt_s, distance_m):
    cdef Array rates = doubles(rate_rad_s), dt = doubles(dt_s), distance = doubles(distance_m)
    cdef Py_ssize_t k
    cdef double way_m = 0.0, turn_rad = 0.0, whole_way_m = 0.0, whole_turn_rad = 0.0, turn
    for k in range(length(dt)):
        turn = at(rates)[3 * k + 2] * at(dt)[k]
        way_m += at(distance)[k]
        turn_rad += turn
        whole_way_m += fabs(at(distance)[k])
        whole_turn_rad += fabs(turn)
    return way_m, turn_rad, whole_way_m, whole_turn_rad


def rate_scatter(rate_rad_s, dt_s):
    cdef Array rates = doubles(rate_rad_s), intervals_s = doubles(dt_s), bends = vector(3)
    cdef Py_ssize_t n = length(intervals_s), k, axis
    cdef double turned = 0.0, duration = 0.0, steps = 0.0, step, bend, inside = 0.0, square = 0.0
    cdef const double* rate = at(rates)
    cdef const double* dt = at(intervals_s)
    clear(at(bends), 3)
    for k in range(n):
        turned += rate[3 * k + 2] * dt[k]
        duration += dt[k]
        if k > 0:
            step = rate[3 * k + 2] - rate[3 * k - 1]
            steps += step * step
        if 0 < k < n - 1:
            inside += dt[k]
            for axis in range(3):
                bend = rate[3 * (k + 1) + axis] - 2.0 * rate[3 * k + axis] + rate[3 * (k - 1) + axis]
                at(bends)[axis] += bend * bend
    if n > 2:
        inside /= n - 2
        for axis in range(3):
            at(bends)[axis] *= duration / n / (n - 2)
        for k in range(1, n - 1):
            square += (dt[k] - inside) * (dt[k] - inside)
    return (
        turned / duration,
        steps / (n - 1) * duration / n if n > 1 else 0.0,
        bends,
        sqrt(square / (n - 2)) / inside if n > 4 else 0.0,
    )


def mean_at_end(values, dt_s, double length_s):
    cdef Array numbers = doubles(values), dt = doubles(dt_s)
    cdef Py_ssize_t k = length(dt) - 1
    cdef double left_s = max(length_s, at(dt)[k]), total = 0.0, duration_s = 0.0, within_s
    while k >= 0 and left_s > 0.0:
        within_s = min(at(dt)[k], left_s)
        total += within_s * at(numbers)[k]
        duration_s += within_s
        left_s -= at(dt)[k]
        k -= 1
    return total / duration_s


def cosines(values, double low, double high, explained):
    cdef Array signal = doubles(values), weights = doubles(explained)
    cdef Py_ssize_t n = length(signal), k = length(weights, 1), i, j
    cdef Array functions = matrix(n, k)
    cdef double* row
    cdef double within, part
    cdef bint with_signal = length(weights) > 1
    for i in range(n):
        row = at(functions) + i * k
        if isnan(at(signal)[i]):
            clear(row, k)
            continue
        within = min(max(at(signal)[i], low), high)
        part = M_PI * ((within - low) / (high - low))
        for j in range(k):
            row[j] = cos((j + 1) * part) - at(weights)[j]
            if with_signal:
                row[j] -= within * at(weights)[k + j]
    return functions


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


def gained(gain, list parts, list starts, Py_ssize_t count):
    cdef Array gains = doubles(gain), products, part
    cdef Py_ssize_t p = length(gains), n = length(gains, 1), first, i, j, k, number
    cdef const char* row
    cdef double* total
    cdef double factor
    products = matrix(p, count)
    clear(at(products), p * count)
    for number in range(len(parts)):
        # Columns are views of signals: no copies, whatever their order in memory.
        part, first = cnp.PyArray_FROM_OTF(parts[number], cnp.NPY_DOUBLE, cnp.NPY_ARRAY_ALIGNED), starts[number]
        if cnp.PyArray_NDIM(part) != 2 or length(part) != n or first + length(part, 1) > count:
            raise ValueError(f'columns of shape {parts[number].shape} at {first} of {count}, for {n} samples')
        for i in range(p):
            total = at(products) + i * count + first
            for k in range(n):
                factor = at(gains)[i * n + k]
                row = <const char*>cnp.PyArray_DATA(part) + k * cnp.PyArray_STRIDE(part, 0)
                for j in range(length(part, 1)):
                    total[j] += factor * (<const double*>(row + j * cnp.PyArray_STRIDE(part, 1)))[0]
    return products


def low_pass(const double[:, :] drive, const double[:, :] kept, start):
    cdef Py_ssize_t n = drive.shape[0], q = drive.shape[1], k, i
    solution = np.empty((n + 1, q))
    cdef double[:, ::1] h = solution
    solution[0] = start
    for k in range(n):
        for i in range(q):
            h[k + 1, i] = drive[k, i] + kept[k, i] * (h[k, i] - drive[k, i])
    return solution


def step_numbers(before, predicted, after, dt_s, correction, rate_rad_s, euler_rad):
    cdef Array x_before = doubles(before.mean), x_expected = doubles(predicted.mean), x = doubles(after.mean)
    cdef Array P_expected = doubles(predicted.covariance), P_after = doubles(after.covariance), dt = doubles(dt_s)
    cdef Array of_correction = doubles(correction.by_values), corrections = doubles(correction.rate_rad_s)
    cdef Array rates = doubles(rate_rad_s), euler = doubles(euler_rad)
    cdef Py_ssize_t n = length(dt), k = after.coefficient_count, r = 9 + k, i, j
    cdef Py_ssize_t across = length(x) + 1, across_expected = length(x_expected) + 1
    cdef double corrected = 0.0, turned = 0.0
    cdef Array std = vector(r), change = vector(1 + k), change_variance = vector(1 + k), columns = vector(k)
    for i in range(r):
        at(std)[i] = sqrt(at(P_after)[i * across])
    for i in range(8, r):
        at(change)[i - 8] = at(x)[i] - at(x_expected)[i]
        at(change_variance)[i - 8] = at(P_expected)[i * across_expected] - at(P_after)[i * across]
    clear(at(columns), k)
    for j in range(n):
        corrected += at(dt)[j] * at(corrections)[j]
        turned += at(dt)[j] * at(rates)[3 * j + 2]
        for i in range(k):
            at(columns)[i] += at(dt)[j] * at(of_correction)[j * k + i]
    for i in range(k):
        corrected += at(columns)[i] * (at(x)[9 + i] - at(x_before)[9 + i])
    return std, change, change_variance, columns, corrected, at(euler)[2] - at(x_before)[5] - turned
