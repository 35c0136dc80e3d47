"""Vectors and matrices of three as tuples.

The filter works on them at each IMU sample. The compiler keeps tuples in registers; arrays go through memory.
"""

import math

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.runtime import inlined

Vector = tuple[float, float, float]
Matrix = tuple[Vector, Vector, Vector]  # three rows


def vector(array: Floats) -> Vector:
    """Read an array of shape (3,); not for compiled code."""
    x, y, z = array.tolist()
    return x, y, z


def matrix(array: Floats) -> Matrix:
    """Read an array of shape (3, 3); not for compiled code."""
    return vector(array[0]), vector(array[1]), vector(array[2])


@inlined
def row_vector(array: Floats, row: int) -> Vector:
    """Read a row of an array of shape (k, 3)."""
    return array[row, 0], array[row, 1], array[row, 2]


@inlined
def row_matrix(array: Floats, row: int) -> Matrix:
    """Read a row of an array of shape (k, 3, 3)."""
    return (
        (array[row, 0, 0], array[row, 0, 1], array[row, 0, 2]),
        (array[row, 1, 0], array[row, 1, 1], array[row, 1, 2]),
        (array[row, 2, 0], array[row, 2, 1], array[row, 2, 2]),
    )


@inlined
def write_row_vector(a: Vector, array: Floats, row: int) -> None:
    """Write a row of an array of shape (k, 3)."""
    array[row, 0], array[row, 1], array[row, 2] = a


@inlined
def write_column_vector(a: Vector, array: Floats, column: int) -> None:
    """Write a column of an array of shape (3, k)."""
    array[0, column], array[1, column], array[2, column] = a


@inlined
def write_row_matrix(mat: Matrix, array: Floats, row: int) -> None:
    """Write a row of an array of shape (k, 3, 3)."""
    array[row, 0, 0], array[row, 0, 1], array[row, 0, 2] = mat[0]
    array[row, 1, 0], array[row, 1, 1], array[row, 1, 2] = mat[1]
    array[row, 2, 0], array[row, 2, 1], array[row, 2, 2] = mat[2]


@inlined
def write_blocks(blocks: tuple[Matrix, ...], array: Floats) -> None:
    """Write matrices side by side into an array of shape (3, 3 k)."""
    for block, mat in enumerate(blocks):
        for i, row in enumerate(mat):
            array[i, 3 * block], array[i, 3 * block + 1], array[i, 3 * block + 2] = row


@inlined
def add(a: Vector, b: Vector) -> Vector:
    """Return ``a + b``."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inlined
def subtract(a: Vector, b: Vector) -> Vector:
    """Return ``a - b``."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inlined
def scale(factor: float, a: Vector) -> Vector:
    """Return ``factor a``."""
    return factor * a[0], factor * a[1], factor * a[2]


@inlined
def dot(a: Vector, b: Vector) -> float:
    """Return the scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def cross(a: Vector, b: Vector) -> Vector:
    """Return ``a x b``."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def skew(a: Vector) -> Matrix:
    """Return ``[a x]``, the matrix of the cross product."""
    return (0.0, -a[2], a[1]), (a[2], 0.0, -a[0]), (-a[1], a[0], 0.0)


@inlined
def transpose(mat: Matrix) -> Matrix:
    """Return the transposed matrix, which for a rotation is its inverse."""
    return (
        (mat[0][0], mat[1][0], mat[2][0]),
        (mat[0][1], mat[1][1], mat[2][1]),
        (mat[0][2], mat[1][2], mat[2][2]),
    )


@inlined
def rotate(mat: Matrix, a: Vector) -> Vector:
    """Return ``mat @ a``."""
    return dot(mat[0], a), dot(mat[1], a), dot(mat[2], a)


@inlined
def rotate_back(mat: Matrix, a: Vector) -> Vector:
    """Return ``mat.T @ a``."""
    return rotate(transpose(mat), a)


@inlined
def compose(mat_ab: Matrix, mat_bc: Matrix) -> Matrix:
    """Return ``mat_ac = mat_ab @ mat_bc``."""
    columns = transpose(mat_bc)
    return rotate(columns, mat_ab[0]), rotate(columns, mat_ab[1]), rotate(columns, mat_ab[2])


@inlined
def scale_matrix(factor: float, mat: Matrix) -> Matrix:
    """Return ``factor mat``."""
    return scale(factor, mat[0]), scale(factor, mat[1]), scale(factor, mat[2])


@inlined
def rotation_from_vector(rotation: Vector) -> Matrix:
    """Return the rotation matrix exp([rotation x]) of a rotation vector in rad, by Rodrigues' formula.

    Below 0.01 rad, series replace sine and cosine. They are exact there to the last bit but one.
    """
    x, y, z = rotation
    square = x * x + y * y + z * z
    if square < 1e-4:
        sine = 1.0 - square * (1.0 / 6.0 - square * (1.0 / 120.0))
        versine = 0.5 - square * (1.0 / 24.0 - square * (1.0 / 720.0))
    else:
        angle = math.sqrt(square)
        sine = math.sin(angle) / angle
        versine = (1.0 - math.cos(angle)) / square
    return (
        (1.0 - versine * (y * y + z * z), versine * x * y - sine * z, versine * x * z + sine * y),
        (versine * x * y + sine * z, 1.0 - versine * (x * x + z * z), versine * y * z - sine * x),
        (versine * x * z - sine * y, versine * y * z + sine * x, 1.0 - versine * (x * x + y * y)),
    )


@inlined
def nearest_turn(angle: float) -> float:
    """Return an angle in [-pi, pi)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi
