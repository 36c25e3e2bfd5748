"""Which triangles a ray hits, in whole numbers: the judge where two tracers differ."""

from fractions import Fraction

import numpy as np


class Judge:
    """Knows a mesh as float32 corners, (m, 3, 3)."""

    def __init__(self, corners):
        assert corners.dtype == np.float32
        self.corners = corners
        self.wide = corners.astype(np.float64)

    def candidates(self, origin, direction):
        """Triangles that the ray might hit, by float64 with room for its errors."""
        a, b, c = np.moveaxis(self.wide, 1, 0)
        origin, direction = origin.astype(np.float64), direction.astype(np.float64)
        normals = np.cross(b - a, c - a)
        det = -normals @ direction
        ao = origin - a
        dao = np.cross(ao, direction)
        u, v = np.einsum("ij,ij->i", c - a, dao), -np.einsum("ij,ij->i", b - a, dao)
        room = 1e-9 * np.linalg.norm(normals, axis=1) * np.linalg.norm(direction) + 1e-3 * np.abs(det)
        sign = np.sign(det)
        inside = (u * sign > -room) & (v * sign > -room) & ((u + v) * sign < np.abs(det) + room)
        return np.flatnonzero(inside | (np.abs(det) < room))

    def hits(self, origin, direction):
        """(t, face, whether on an edge) of all triangles with t >= 0 that the ray hits, edges included, by t; t exact."""
        found = []
        o, d = _fractions(origin), _fractions(direction)
        for face in self.candidates(origin, direction):
            a, b, c = (_fractions(corner) for corner in self.corners[face])
            e1, e2, ao = _minus(b, a), _minus(c, a), _minus(o, a)
            normal, dao = _cross(e1, e2), _cross(ao, d)
            det = -_dot(normal, d)
            if det == 0:
                continue
            u, v, t = _dot(e2, dao) / det, -_dot(e1, dao) / det, _dot(normal, ao) / det
            if min(u, v, 1 - u - v) >= 0 and t >= 0:
                found.append((t, int(face), min(u, v, 1 - u - v) == 0))
        return sorted(found)

    def clearance(self, face, origin, direction):
        """How far the line passes from the nearest edge of a triangle."""
        corners, direction = self.wide[face], direction.astype(np.float64)
        origin = origin.astype(np.float64)
        return min(_apart(corners[i], corners[i - 1], origin, direction) for i in range(3))


def _apart(p, q, origin, direction):
    """The distance of a line from a segment."""
    direction = direction / np.linalg.norm(direction)
    flat = lambda x: x - origin - direction * ((x - origin) @ direction)  # noqa: E731
    p, q = flat(p), flat(q)
    along = q - p
    share = np.clip(-(p @ along) / max(along @ along, 1e-300), 0, 1)
    return np.linalg.norm(p + share * along)


def _fractions(point):
    return [Fraction(float(x)) for x in point]


def _minus(a, b):
    return [x - y for x, y in zip(a, b)]


def _dot(a, b):
    return sum(x * y for x, y in zip(a, b))


def _cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
