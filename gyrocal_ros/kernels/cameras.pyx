# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Twins of `model.rotation`, `model.lens`, `model.camera`, `model.features`, `effects.camera_tilt`,
`ekf.state.columns` and `ekf.equations.effects_by_place`, which explain the equations."""

from libc.math cimport atan, cos, fabs, sin, sqrt

cimport numpy as cnp
from numpy cimport ndarray as Array

from gyrocal_ros.kernels.arrays cimport at, clear, copied, cube, doubles, length, matrix, vector
from gyrocal_ros.kernels.rotations cimport rotate

cnp.import_array()

TWINS = (
    'pixels_by_delay',
    'pixels_by_radial_coefficients',
    'pixels_by_tilt',
    'predict_inverse_depth',
    'project_with_jacobian',
    'rotation_derivatives',
    'rotation_from_euler',
    'side_by_side',
    'turned_camera',
    'undistort_brown',
)

cdef enum Lens:
    PINHOLE
    BROWN
    EQUIDISTANT

cdef double MIN_DEPTH = 1e-6
cdef double SMALL_RADIUS = 1e-4


cdef struct Camera:
    Lens lens
    double fx, fy, cx, cy
    double k[8]


cdef Camera camera_of(object intrinsics):
    cdef Camera camera
    cdef tuple distortion = intrinsics.distortion
    cdef Py_ssize_t i
    camera.fx, camera.fy = intrinsics.fx_px, intrinsics.fy_px
    camera.cx, camera.cy = intrinsics.cx_px, intrinsics.cy_px
    for i in range(8):
        camera.k[i] = 0.0
    for i in range(len(distortion)):
        camera.k[i] = distortion[i]
    camera.lens = EQUIDISTANT if intrinsics.lens == 'equidistant' else PINHOLE
    for i in range(8):
        if camera.lens == PINHOLE and camera.k[i] != 0.0:
            camera.lens = BROWN
    return camera


cdef void distort(Camera* camera, double x, double y, double* at, double* slopes) noexcept nogil:
    """Write the distorted coordinates (2) and their derivative (3): by xx, xy = yx and yy."""
    cdef double* k = camera.k
    cdef double xx = x * x, yy = y * y, xy = x * y
    cdef double r2 = xx + yy
    cdef double radial, slope, denominator, angle, a2, bent, r
    if camera.lens == PINHOLE:
        at[0], at[1] = x, y
        slopes[0], slopes[1], slopes[2] = 1.0, 0.0, 1.0
        return
    if camera.lens == BROWN:
        radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
        slope = 2.0 * (k[0] + r2 * (2.0 * k[1] + r2 * (3.0 * k[4])))
        if k[5] != 0.0 or k[6] != 0.0 or k[7] != 0.0:
            denominator = 1.0 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
            radial = radial / denominator
            slope = (slope - radial * 2.0 * (k[5] + r2 * (2.0 * k[6] + r2 * (3.0 * k[7])))) / denominator
        at[0] = x * radial + 2.0 * k[2] * xy + k[3] * (r2 + 2.0 * xx)
        at[1] = y * radial + k[2] * (r2 + 2.0 * yy) + 2.0 * k[3] * xy
        slopes[0] = radial + slope * xx + 2.0 * k[2] * y + 6.0 * k[3] * x
        slopes[1] = slope * xy + 2.0 * (k[2] * x + k[3] * y)
        slopes[2] = radial + slope * yy + 6.0 * k[2] * y + 2.0 * k[3] * x
        return
    if r2 < SMALL_RADIUS * SMALL_RADIUS:
        slope = 2.0 * (k[0] - 1.0 / 3.0)
        radial = 1.0 + 0.5 * slope * r2
    else:
        r = sqrt(r2)
        angle = atan(r)
        a2 = angle * angle
        bent = angle * (1.0 + a2 * (k[0] + a2 * (k[1] + a2 * (k[2] + a2 * k[3]))))
        radial = bent / r
        slope = 1.0 + a2 * (3.0 * k[0] + a2 * (5.0 * k[1] + a2 * (7.0 * k[2] + a2 * 9.0 * k[3])))
        slope = (slope / (1.0 + r2) - radial) / r2
    at[0], at[1] = x * radial, y * radial
    slopes[0], slopes[1], slopes[2] = radial + slope * xx, slope * xy, radial + slope * yy


cdef void project(Camera* camera, const double* point, double* pixel, double* jacobian) noexcept nogil:
    """Write the pixel (2) of a point (3) and its derivative (2, 3)."""
    cdef double inverse_z = 1.0 / max(point[2], MIN_DEPTH)
    cdef double x = point[0] * inverse_z, y = point[1] * inverse_z
    cdef double u[2]
    cdef double slopes[3]
    distort(camera, x, y, u, slopes)
    pixel[0], pixel[1] = u[0] * camera.fx + camera.cx, u[1] * camera.fy + camera.cy
    cdef double by_u = camera.fx * inverse_z, by_v = camera.fy * inverse_z
    jacobian[0], jacobian[1] = slopes[0] * by_u, slopes[1] * by_u
    jacobian[2] = -(slopes[0] * x + slopes[1] * y) * by_u
    jacobian[3], jacobian[4] = slopes[1] * by_v, slopes[2] * by_v
    jacobian[5] = -(slopes[1] * x + slopes[2] * y) * by_v


def project_with_jacobian(camera, points_c):
    cdef Array points = doubles(points_c)
    cdef Py_ssize_t m = length(points), f
    cdef Camera lens = camera_of(camera)
    cdef Array pixels = matrix(m, 2), jacobian = cube(m, 2, 3)
    for f in range(m):
        project(&lens, at(points) + 3 * f, at(pixels) + 2 * f, at(jacobian) + 6 * f)
    return pixels, jacobian


def undistort_brown(camera, distorted, int max_steps, double last_step):
    cdef Camera lens = camera_of(camera)
    cdef Array wanted = doubles(distorted), normalised = copied(wanted)
    cdef Py_ssize_t n = length(wanted), f
    cdef double* u
    cdef double reached[2]
    cdef double slopes[3]
    cdef double longest, x, y, step_x, step_y, determinant
    cdef int iteration
    for iteration in range(max_steps):
        longest = 0.0
        for f in range(n):
            u = at(normalised) + 2 * f
            distort(&lens, u[0], u[1], reached, slopes)
            x, y = reached[0] - at(wanted)[2 * f], reached[1] - at(wanted)[2 * f + 1]
            determinant = slopes[0] * slopes[2] - slopes[1] * slopes[1]
            step_x, step_y = (slopes[2] * x - slopes[1] * y) / determinant, (slopes[0] * y - slopes[1] * x) / determinant
            u[0] -= step_x
            u[1] -= step_y
            longest = max(longest, fabs(step_x), fabs(step_y))
        if longest < last_step:
            break
    return normalised


def predict_inverse_depth(view, parameters, anchors):
    cdef Camera lens = camera_of(view.camera)
    cdef Array of_features = doubles(parameters), anchor_R_wc = doubles(anchors.R_wc), anchor_p_wc = doubles(anchors.p_wc)
    cdef Array attitude = doubles(view.R_wc), derivatives = doubles(view.dR_wc), position = doubles(view.p_wb)
    cdef Array mounting = doubles(view.R_bc), mounted_at = doubles(view.p_bc)
    cdef Py_ssize_t m = length(of_features), f, i, j, l
    cdef Array expected = matrix(m, 2), by_pose = cube(m, 2, 6), by_feature = cube(m, 2, 3), points_c = matrix(m, 3)
    cdef Array by_point = cube(m, 2, 3), scale = vector(m)
    cdef const double* R_wc = at(attitude)
    cdef const double* dR_wc = at(derivatives)
    cdef const double* R_a
    cdef const double* feature
    cdef double* point
    cdef double* jacobian
    cdef double lever_c[3]
    cdef double to_anchor[3]
    cdef double from_robot[3]
    cdef double point_by_pose[3][6]
    cdef double point_by_feature[3][3]
    cdef double rho, sum_
    for i in range(3):
        lever_c[i] = 0.0
        for l in range(3):
            lever_c[i] += at(mounted_at)[l] * at(mounting)[3 * l + i]
    for f in range(m):
        feature, R_a = at(of_features) + 3 * f, at(anchor_R_wc) + 9 * f
        point, jacobian = at(points_c) + 3 * f, at(by_point) + 6 * f
        rho = feature[2]
        at(scale)[f] = rho
        for i in range(3):
            to_anchor[i] = at(anchor_p_wc)[3 * f + i] - at(position)[i]
            from_robot[i] = (
                R_a[3 * i] * feature[0] + R_a[3 * i + 1] * feature[1] + R_a[3 * i + 2] + rho * to_anchor[i]
            )
        for i in range(3):
            point[i] = -rho * lever_c[i]
            point_by_feature[i][0] = point_by_feature[i][1] = 0.0
            point_by_feature[i][2] = -lever_c[i]
            for l in range(3):
                point[i] += from_robot[l] * R_wc[3 * l + i]
                point_by_feature[i][0] += R_wc[3 * l + i] * R_a[3 * l]
                point_by_feature[i][1] += R_wc[3 * l + i] * R_a[3 * l + 1]
                point_by_feature[i][2] += to_anchor[l] * R_wc[3 * l + i]
                point_by_pose[i][l] = -rho * R_wc[3 * l + i]
            for j in range(3):
                point_by_pose[i][3 + j] = 0.0
                for l in range(3):
                    point_by_pose[i][3 + j] += from_robot[l] * dR_wc[9 * j + 3 * l + i]
        project(&lens, point, at(expected) + 2 * f, jacobian)
        for i in range(2):
            for j in range(6):
                sum_ = 0.0
                for l in range(3):
                    sum_ += jacobian[3 * i + l] * point_by_pose[l][j]
                at(by_pose)[12 * f + 6 * i + j] = sum_
            for j in range(3):
                sum_ = 0.0
                for l in range(3):
                    sum_ += jacobian[3 * i + l] * point_by_feature[l][j]
                at(by_feature)[6 * f + 3 * i + j] = sum_
    return expected, by_pose, by_feature, points_c, by_point, scale


def pixels_by_delay(by_pose, pixels, rate, acceleration, double readout_s, double height_px):
    cdef Array poses = doubles(by_pose), seen = doubles(pixels), rates = doubles(rate), change = doubles(acceleration)
    cdef Py_ssize_t m = length(poses), f, i, l
    cdef Array by_offset = matrix(m, 2), by_readout = matrix(m, 2)
    cdef const double* derivative
    cdef double row, delay_s, velocity, turn
    cdef double exposed[2]
    for f in range(m):
        row = (at(seen)[2 * f + 1] + 0.5) / height_px - 0.5
        delay_s = readout_s * row
        for i in range(2):
            derivative = at(poses) + 12 * f + 6 * i
            velocity = turn = 0.0
            for l in range(6):
                velocity += derivative[l] * at(rates)[l]
                turn += derivative[l] * at(change)[l]
            at(by_offset)[2 * f + i] = -velocity
            exposed[i] = velocity + turn * delay_s
        row /= 1.0 - exposed[1] * readout_s / height_px
        at(by_readout)[2 * f], at(by_readout)[2 * f + 1] = exposed[0] * row, exposed[1] * row
    return by_offset, by_readout


def pixels_by_tilt(points_c, by_point, double angle_rad):
    cdef Array points = doubles(points_c), derivative = doubles(by_point)
    cdef Py_ssize_t m = length(points), r = length(derivative, 1), f, i
    cdef double c = cos(angle_rad), s = sin(angle_rad)
    cdef const double* p
    cdef const double* by
    cdef Array result = cube(m, r, 2)
    for f in range(m):
        p = at(points) + 3 * f
        for i in range(r):
            by = at(derivative) + 3 * (f * r + i)
            at(result)[2 * (f * r + i)] = by[1] * p[2] - by[2] * p[1]
            at(result)[2 * (f * r + i) + 1] = -by[0] * (s * p[1] + c * p[2]) + (s * by[1] + c * by[2]) * p[0]
    return result


def pixels_by_radial_coefficients(camera, points_c):
    cdef Camera lens = camera_of(camera)
    cdef double* k = lens.k
    cdef Array points = doubles(points_c)
    cdef Py_ssize_t m = length(points), f
    cdef double x, y, r2, r, angle, first, second, denominator
    cdef Array result = cube(m, 2, 2)
    cdef double* out = at(result)
    cdef const double* p
    for f in range(m):
        p = at(points) + 3 * f
        x, y = p[0] / p[2], p[1] / p[2]
        r2 = x * x + y * y
        if lens.lens == EQUIDISTANT:
            r = max(sqrt(r2), SMALL_RADIUS)
            angle = atan(r)
            first = angle * angle * angle / r
            second = first * angle * angle
        else:
            denominator = 1.0 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
            first = r2 / denominator
            second = r2 * first
        out[4 * f], out[4 * f + 1] = lens.fx * x * first, lens.fx * x * second
        out[4 * f + 2], out[4 * f + 3] = lens.fy * y * first, lens.fy * y * second
    return result


def rotation_from_euler(euler):
    cdef Array angles = doubles(euler), R = matrix(3, 3)
    rotate(at(angles), <double[3]*>at(R))
    return R


cdef Array by_angles(Array angles):
    """Twin of `rotation_derivatives`."""
    cdef const double* euler = at(angles)
    cdef double cr = cos(euler[0]), sr = sin(euler[0]), cp = cos(euler[1]), sp = sin(euler[1])
    cdef double cy = cos(euler[2]), sy = sin(euler[2])
    cdef Array matrices = cube(3, 3, 3)
    cdef double* dR = at(matrices)  # by roll from 0, by pitch from 9, by yaw from 18
    clear(dR, 27)
    dR[1], dR[2] = cy * sp * cr + sy * sr, -cy * sp * sr + sy * cr
    dR[4], dR[5] = sy * sp * cr - cy * sr, -sy * sp * sr - cy * cr
    dR[7], dR[8] = cp * cr, -cp * sr
    dR[9], dR[10], dR[11] = -cy * sp, cy * cp * sr, cy * cp * cr
    dR[12], dR[13], dR[14] = -sy * sp, sy * cp * sr, sy * cp * cr
    dR[15], dR[16], dR[17] = -cp, -sp * sr, -sp * cr
    dR[18], dR[19], dR[20] = -sy * cp, -sy * sp * sr - cy * cr, -sy * sp * cr + cy * sr
    dR[21], dR[22], dR[23] = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
    return matrices


def rotation_derivatives(euler):
    return by_angles(doubles(euler))


cdef void multiply(const double* R, const double* R_bc, double* product) noexcept nogil:
    """Write the product of two matrices (3, 3)."""
    cdef Py_ssize_t i, j
    for i in range(3):
        for j in range(3):
            product[3 * i + j] = R[3 * i] * R_bc[j] + R[3 * i + 1] * R_bc[3 + j] + R[3 * i + 2] * R_bc[6 + j]


def turned_camera(position_m, euler_rad, R_bc, p_bc):
    cdef Array position = doubles(position_m), angles = doubles(euler_rad), mounting = doubles(R_bc), lever = doubles(p_bc)
    cdef Array R_wb = matrix(3, 3), dR_wb = by_angles(angles), R_wc = matrix(3, 3), dR_wc = cube(3, 3, 3)
    cdef Array p_wc = vector(3)
    cdef Py_ssize_t i, l
    rotate(at(angles), <double[3]*>at(R_wb))
    multiply(at(R_wb), at(mounting), at(R_wc))
    for i in range(3):
        multiply(at(dR_wb) + 9 * i, at(mounting), at(dR_wc) + 9 * i)
        at(p_wc)[i] = at(position)[i]
        for l in range(3):
            at(p_wc)[i] += at(R_wb)[3 * i + l] * at(lever)[l]
    return R_wb, dR_wb, R_wc, dR_wc, p_wc


def side_by_side(list parts, list starts, Py_ssize_t count):
    cdef Array part = doubles(parts[0]), by_values
    cdef Py_ssize_t rows = 2 * length(part), number, first, k, i, j
    cdef const double* source
    by_values = cube(length(part), 2, count)
    clear(at(by_values), rows * count)
    for number in range(len(parts)):
        part, first = doubles(parts[number]), starts[number]
        if cnp.PyArray_NDIM(part) != 3 or 2 * length(part) != rows or first + length(part, 2) > count:
            raise ValueError(f'columns of shape {parts[number].shape} at {first} of {count}, for {rows} rows')
        source, k = at(part), length(part, 2)
        for i in range(rows):
            for j in range(k):
                at(by_values)[i * count + first + j] = source[i * k + j]
    return by_values
