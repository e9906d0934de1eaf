"""Compiled loops that draw primitives into a grid of camera rays, exactly, as inverse depth.

Along the ray of a cell the inverse depth of a plane is affine in (column, row), and so is every condition
that the cell lies inside a face. A face is therefore drawn row by row: the conditions give the span of columns,
and the greatest inverse depth wins. Nothing is tested outside a primitive's window. A face behind the camera has
empty spans, so that no clipping is needed. A primitive that holds the camera is not seen.

``view`` (7, 3) is the grid of rays, as of ``raycast.ray_grid``. ``nearness`` (h, w) float64 is the inverse
depth, 0 for sky. ``faces`` (h, w) int32 is 8 × primitive + face: faces of a box and caps are
2 × axis + (1 on the positive side), the side of a cylinder is 6.

All of it stays in one file: numba's cache does not notice a change in a function that another file calls.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray
from revnm_server.observation import Image32

IntArray = NDArray[np.int32]
KindArray = NDArray[np.int64]
Window = tuple[int, int, int, int]

FLOOR = -1
SKY = -2
_CYLINDER = 1
_SIDE = 6
_BEHIND_M = 1e-6  # corners nearer to the camera's plane than this open the window to the whole grid
_EDGE_CELLS = 1e-9  # a cell this little outside a face counts as inside, so that faces meet without cracks

_compiled = njit(cache=True, nogil=True, error_model="numpy")


@_compiled
def _frame(k: int, centre_m: FloatArray, half_m: FloatArray, axis: FloatArray, view: FloatArray) -> FloatArray:
    """Return (3 own axes of primitive k, eye | half extent | ray of cell (0, 0) | per column | per row)."""
    frame = np.empty((3, 5))
    c, s = axis[k, 0], axis[k, 1]
    x, y = view[0, 0] - centre_m[k, 0], view[0, 1] - centre_m[k, 1]
    frame[0, 0] = c * x + s * y
    frame[1, 0] = c * y - s * x
    frame[2, 0] = view[0, 2] - centre_m[k, 2]
    for a in range(3):
        frame[a, 1] = half_m[k, a]
        frame[0, 2 + a] = c * view[1 + a, 0] + s * view[1 + a, 1]
        frame[1, 2 + a] = c * view[1 + a, 1] - s * view[1 + a, 0]
        frame[2, 2 + a] = view[1 + a, 2]
    return frame


@_compiled
def _cell(value: float, limit: int) -> int:
    """Return the value, clipped to [0, limit], rounded down."""
    return int(min(max(value, 0.0), float(limit)))


@_compiled
def _window(
    k: int,
    centre_m: FloatArray,
    half_m: FloatArray,
    axis: FloatArray,
    view: FloatArray,
    height: int,
    width: int,
) -> Window:
    """Return the rows and columns [row_0, row_1) × [column_0, column_1) that can see primitive k."""
    low_row = low_column = math.inf
    high_row = high_column = -math.inf
    behind = 0
    for corner in range(8):
        x = half_m[k, 0] if corner & 1 else -half_m[k, 0]
        y = half_m[k, 1] if corner & 2 else -half_m[k, 1]
        dx = centre_m[k, 0] - view[0, 0] + axis[k, 0] * x - axis[k, 1] * y
        dy = centre_m[k, 1] - view[0, 1] + axis[k, 1] * x + axis[k, 0] * y
        dz = centre_m[k, 2] - view[0, 2] + (half_m[k, 2] if corner & 4 else -half_m[k, 2])
        depth = view[6, 0] * dx + view[6, 1] * dy + view[6, 2] * dz
        if depth < _BEHIND_M:
            behind += 1
            continue
        column = (view[4, 0] * dx + view[4, 1] * dy + view[4, 2] * dz) / depth
        row = (view[5, 0] * dx + view[5, 1] * dy + view[5, 2] * dz) / depth
        low_column, high_column = min(low_column, column), max(high_column, column)
        low_row, high_row = min(low_row, row), max(high_row, row)
    if behind == 8:
        return 0, 0, 0, 0
    if behind > 0:
        return 0, height, 0, width
    return (
        _cell(low_row, height),
        _cell(high_row + 2.0, height),
        _cell(low_column, width),
        _cell(high_column + 2.0, width),
    )


@_compiled
def _span(conditions: FloatArray, row: int, low: int, high: int) -> tuple[int, int]:
    """Return the columns [low, high) of a row in which all conditions a + b · column + c · row >= 0 hold."""
    for n in range(conditions.shape[0]):
        value = conditions[n, 0] + conditions[n, 2] * row
        slope = conditions[n, 1]
        if abs(slope) < 1e-13:
            if value < -1e-12:
                return 0, 0
        elif slope > 0.0:
            low = max(low, _cell(np.ceil(-value / slope - _EDGE_CELLS), high))
        else:
            high = min(high, _cell(-value / slope + _EDGE_CELLS + 1.0, high))
    return low, high


@_compiled
def _paint_face(
    frame: FloatArray, normal: int, code: int, window: Window, nearness: FloatArray, faces: IntArray
) -> None:
    """Draw the face of a box, or none, that looks at the eye along one of the box's axes."""
    eye, half = frame[normal, 0], frame[normal, 1]
    if abs(eye) <= half:
        return
    positive = eye > 0.0
    to_plane = (half if positive else -half) - eye
    plane = frame[normal, 2:] / to_plane  # inverse depth: plane[0] + plane[1] * column + plane[2] * row
    conditions = np.empty((4, 3))
    for n in range(2):
        other = (normal + 1 + n) % 3
        for m in range(3):
            conditions[2 * n, m] = (frame[other, 1] - frame[other, 0]) * plane[m] - frame[other, 2 + m]
            conditions[2 * n + 1, m] = (frame[other, 1] + frame[other, 0]) * plane[m] + frame[other, 2 + m]
    face = code + 2 * normal + (1 if positive else 0)
    for row in range(window[0], window[1]):
        low, high = _span(conditions, row, window[2], window[3])
        start = plane[0] + plane[2] * row
        for column in range(low, high):
            near = start + plane[1] * column
            if near > nearness[row, column]:
                nearness[row, column] = near
                faces[row, column] = face


@_compiled
def _side_conditions(frame: FloatArray, room: float) -> FloatArray:
    """Return the conditions that a ray passes between a cylinder's tangent planes; none from within it."""
    if room <= 0.0:
        return np.empty((0, 3))
    eye_x, eye_y, radius = frame[0, 0], frame[1, 0], frame[0, 1]
    tangent = math.sqrt(room)
    conditions = np.empty((2, 3))
    for n in range(2):
        # The tangent: -eye turned by asin(radius / |eye|), not normalised.
        turn = radius if n == 0 else -radius
        x, y = -eye_x * tangent + eye_y * turn, -eye_y * tangent - eye_x * turn
        for m in range(3):
            cross = x * frame[1, 2 + m] - y * frame[0, 2 + m]
            conditions[n, m] = -cross if n == 0 else cross
    return conditions


@_compiled
def _paint_cylinder(frame: FloatArray, code: int, window: Window, nearness: FloatArray, faces: IntArray) -> None:
    """Draw an upright cylinder: per cell the nearer root of its side, and the cap that looks at the eye."""
    eye_x, eye_y, eye_z = frame[0, 0], frame[1, 0], frame[2, 0]
    radius, half = frame[0, 1], frame[2, 1]
    room = eye_x * eye_x + eye_y * eye_y - radius * radius
    sees_cap = abs(eye_z) > half
    to_cap = (half if eye_z > 0.0 else -half) - eye_z
    cap = code + (5 if eye_z > 0.0 else 4)
    conditions = _side_conditions(frame, room)
    for row in range(window[0], window[1]):
        low, high = _span(conditions, row, window[2], window[3])
        for column in range(low, high):
            x = frame[0, 2] + frame[0, 3] * column + frame[0, 4] * row
            y = frame[1, 2] + frame[1, 3] * column + frame[1, 4] * row
            z = frame[2, 2] + frame[2, 3] * column + frame[2, 4] * row
            if room > 0.0:
                along = eye_x * x + eye_y * y
                root = along * along - (x * x + y * y) * room
                near = (math.sqrt(max(root, 0.0)) - along) / room
                if near > nearness[row, column] and abs(eye_z * near + z) <= half * near:
                    nearness[row, column] = near
                    faces[row, column] = code + _SIDE
            if sees_cap:
                near = z / to_cap
                hit_x, hit_y = eye_x * near + x, eye_y * near + y
                if near > nearness[row, column] and hit_x * hit_x + hit_y * hit_y <= (radius * near) ** 2:
                    nearness[row, column] = near
                    faces[row, column] = cap


@_compiled
def _paint(k: int, shape: KindArray, frame: FloatArray, window: Window, nearness: FloatArray, faces: IntArray) -> None:
    """Draw primitive k."""
    if window[1] <= window[0] or window[3] <= window[2]:
        return
    if shape[k] == _CYLINDER:
        _paint_cylinder(frame, 8 * k, window, nearness, faces)
        return
    for normal in range(3):
        _paint_face(frame, normal, 8 * k, window, nearness, faces)


@_compiled
def paint_all(
    shape: KindArray,
    centre_m: FloatArray,
    half_m: FloatArray,
    axis: FloatArray,
    view: FloatArray,
    grid_hw: tuple[int, int],
) -> tuple[FloatArray, IntArray]:
    """Draw the floor z = 0 and all primitives; return (nearness, faces), where faces may be FLOOR or SKY."""
    height, width = grid_hw
    nearness = np.empty((height, width))
    faces = np.empty((height, width), np.int32)
    above = view[0, 2] > 0.0
    for row in range(height):
        for column in range(width):
            near = -(view[1, 2] + view[2, 2] * column + view[3, 2] * row) / view[0, 2] if above else 0.0
            nearness[row, column] = near if near > 0.0 else 0.0  # never -0.0, whose inverse is -inf
            faces[row, column] = FLOOR if near > 0.0 else SKY
    for k in range(shape.shape[0]):
        window = _window(k, centre_m, half_m, axis, view, height, width)
        _paint(k, shape, _frame(k, centre_m, half_m, axis, view), window, nearness, faces)
    return nearness, faces


@_compiled
def depth_of(nearness: FloatArray, max_depth_m: float) -> Image32:
    """Return the depth (h, w), metres; sky and what is farther than the limit are inf."""
    depth = np.empty(nearness.shape, np.float32)
    for row in range(nearness.shape[0]):
        for column in range(nearness.shape[1]):
            metres = 1.0 / nearness[row, column]  # 1 / 0 is inf here
            depth[row, column] = metres if metres <= max_depth_m else math.inf
    return depth


@_compiled
def paint_over(
    shape: KindArray,
    centre_m: FloatArray,
    half_m: FloatArray,
    axis: FloatArray,
    view: FloatArray,
    depth_m: Image32,
    nearness: FloatArray,
) -> None:
    """Draw the arrays' only primitive into a depth image (h, w), in place; ``nearness`` (h, w) is zeros."""
    faces = np.empty(nearness.shape, np.int32)
    window = _window(0, centre_m, half_m, axis, view, nearness.shape[0], nearness.shape[1])
    _paint(0, shape, _frame(0, centre_m, half_m, axis, view), window, nearness, faces)
    for row in range(window[0], window[1]):
        for column in range(window[2], window[3]):
            metres = np.float32(1.0 / nearness[row, column])
            depth_m[row, column] = min(metres, depth_m[row, column])


@_compiled
def normals_of(
    faces: IntArray, nearness: FloatArray, centre_m: FloatArray, axis: FloatArray, view: FloatArray
) -> tuple[IntArray, Image32]:
    """Return which primitive every cell sees (h, w), FLOOR or SKY, and the surface normal there (h, w, 3).

    Normals are unit vectors in the world frame; that of the floor is (0, 0, 1), that of the sky 0.
    """
    height, width = faces.shape
    ids = np.empty((height, width), np.int32)
    normals = np.zeros((height, width, 3), np.float32)
    for row in range(height):
        for column in range(width):
            code = faces[row, column]
            k, face = code >> 3, code & 7
            ids[row, column] = k if code >= 0 else code
            if code == SKY:
                continue
            if code == FLOOR or face == 4 or face == 5:
                normals[row, column, 2] = -1.0 if code >= 0 and face == 4 else 1.0
                continue
            if face == _SIDE:
                near = nearness[row, column]
                x = view[0, 0] - centre_m[k, 0] + (view[1, 0] + view[2, 0] * column + view[3, 0] * row) / near
                y = view[0, 1] - centre_m[k, 1] + (view[1, 1] + view[2, 1] * column + view[3, 1] * row) / near
                length = math.hypot(x, y)
                normals[row, column, 0], normals[row, column, 1] = x / length, y / length
                continue
            sign = 1.0 if face & 1 else -1.0
            c, s = sign * axis[k, 0], sign * axis[k, 1]
            normals[row, column, 0] = c if face < 2 else -s
            normals[row, column, 1] = s if face < 2 else c
    return ids, normals
