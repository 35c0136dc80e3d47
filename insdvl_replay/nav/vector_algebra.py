"""Vectors and matrices of three as tuples.

The filter works on them once for each IMU sample. The compiler keeps tuples in registers, where arrays of three would
go through memory.
"""

import math

from insdvl_replay.columns import Floats
from insdvl_replay.compiled import compiled

Vector = tuple[float, float, float]
Matrix = tuple[Vector, Vector, Vector]
"""Three rows."""


@compiled
def vector(array: Floats) -> Vector:
    """Read an array of shape (3,)."""
    return array[0], array[1], array[2]


@compiled
def row_vector(array: Floats, row: int) -> Vector:
    """Read a row of an array of shape (k, 3); a view of it would be counted as a reference, which takes longer."""
    return array[row, 0], array[row, 1], array[row, 2]


@compiled
def matrix(array: Floats) -> Matrix:
    """Read an array of shape (3, 3)."""
    return (
        (array[0, 0], array[0, 1], array[0, 2]),
        (array[1, 0], array[1, 1], array[1, 2]),
        (array[2, 0], array[2, 1], array[2, 2]),
    )


@compiled
def write_vector(a: Vector, array: Floats) -> None:
    """Write into an array of shape (3,)."""
    array[0], array[1], array[2] = a


@compiled
def write_matrix(mat: Matrix, array: Floats) -> None:
    """Write into an array of shape (3, 3)."""
    array[0, 0], array[0, 1], array[0, 2] = mat[0]
    array[1, 0], array[1, 1], array[1, 2] = mat[1]
    array[2, 0], array[2, 1], array[2, 2] = mat[2]


@compiled
def add(a: Vector, b: Vector) -> Vector:
    """Give ``a + b``."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@compiled
def subtract(a: Vector, b: Vector) -> Vector:
    """Give ``a - b``."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@compiled
def scale(factor: float, a: Vector) -> Vector:
    """Give ``factor a``."""
    return factor * a[0], factor * a[1], factor * a[2]


@compiled
def dot(a: Vector, b: Vector) -> float:
    """Give the scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def cross(a: Vector, b: Vector) -> Vector:
    """Give ``a x b``."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@compiled
def transpose(mat: Matrix) -> Matrix:
    """Give the rows as columns; of a rotation, its inverse."""
    return (mat[0][0], mat[1][0], mat[2][0]), (mat[0][1], mat[1][1], mat[2][1]), (mat[0][2], mat[1][2], mat[2][2])


@compiled
def rotate(mat: Matrix, a: Vector) -> Vector:
    """Give ``mat @ a``."""
    return dot(mat[0], a), dot(mat[1], a), dot(mat[2], a)


@compiled
def rotate_back(mat: Matrix, a: Vector) -> Vector:
    """Give ``mat.T @ a``."""
    return rotate(transpose(mat), a)


@compiled
def compose(mat_ab: Matrix, mat_bc: Matrix) -> Matrix:
    """Give ``mat_ac = mat_ab @ mat_bc``."""
    columns = transpose(mat_bc)
    return rotate(columns, mat_ab[0]), rotate(columns, mat_ab[1]), rotate(columns, mat_ab[2])


@compiled
def rotation_from_vector(rotation: Vector) -> Matrix:
    """Give the rotation matrix exp([rotation x]) by Rodrigues' formula.

    Below 0.01 rad the sine and cosine are replaced by their series, which there are exact to the last bit but one.

    Parameters
    ----------
    rotation : tuple of 3 float
        rad

    Returns
    -------
    tuple of 3 rows
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
