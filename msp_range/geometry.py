"""Rotations of a mounting: Euler angles, boresight, quaternion.

Frames: body is FRD (x forward, y right, z down). Angles are intrinsic z-y'-x'' (yaw, then pitch, then roll), as in
MAVLink and aerospace: R = Rz(yaw) Ry(pitch) Rx(roll) takes a vector from the sensor's frame to the body's. A sensor's
boresight is its own x axis, so pitch -90 deg looks down.
"""

from math import atan2, cos, dist, sin

Vector = tuple[float, float, float]
Matrix = tuple[Vector, Vector, Vector]
Quaternion = tuple[float, float, float, float]


def rotation_matrix(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Matrix:
    """R = Rz(yaw) Ry(pitch) Rx(roll), rows first, 3 x 3.

    Examples
    --------
    >>> from math import pi
    >>> boresight = [row[0] for row in rotation_matrix(0.0, -pi / 2, 0.0)]
    >>> [f"{component:.1f}" for component in boresight]
    ['0.0', '0.0', '1.0']
    """
    cr, sr = cos(roll_rad), sin(roll_rad)
    cp, sp = cos(pitch_rad), sin(pitch_rad)
    cy, sy = cos(yaw_rad), sin(yaw_rad)
    return (
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    )


def down_axis(roll_rad: float, pitch_rad: float) -> Vector:
    """Last row of `rotation_matrix`: straight down in the body's frame."""
    cp = cos(pitch_rad)
    return -sin(pitch_rad), cp * sin(roll_rad), cp * cos(roll_rad)


def boresight(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Vector:
    """First column of `rotation_matrix`: the direction in which the sensor looks, body FRD."""
    first, second, third = rotation_matrix(roll_rad, pitch_rad, yaw_rad)
    return first[0], second[0], third[0]


def quaternion(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Quaternion:
    """(w, x, y, z) of `rotation_matrix`, w >= 0."""
    cr, sr = cos(roll_rad / 2), sin(roll_rad / 2)
    cp, sp = cos(pitch_rad / 2), sin(pitch_rad / 2)
    cy, sy = cos(yaw_rad / 2), sin(yaw_rad / 2)
    w = cr * cp * cy + sr * sp * sy
    x = sr * cp * cy - cr * sp * sy
    y = cr * sp * cy + sr * cp * sy
    z = cr * cp * sy - sr * sp * cy
    return (w, x, y, z) if w >= 0 else (-w, -x, -y, -z)


def dot(a: Vector, b: Vector) -> float:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def rotate(rotation: Matrix, vector: Vector) -> Vector:
    """A vector in the other frame: R v."""
    first, second, third = rotation
    return dot(first, vector), dot(second, vector), dot(third, vector)


def rotate_back(rotation: Matrix, vector: Vector) -> Vector:
    """The vector that `rotate` takes to this one: R^T v."""
    first, second, third = zip(*rotation, strict=True)
    return dot(first, vector), dot(second, vector), dot(third, vector)


def angle_between(a: Vector, b: Vector) -> float:
    """Angle between two unit vectors [rad], 0 to pi; exact near 0 and pi, where the arc cosine is not."""
    opposite = [-each for each in b]
    return 2 * atan2(dist(a, b), dist(a, opposite))
