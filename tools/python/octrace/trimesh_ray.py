"""Rays against a trimesh mesh, by octrace: the methods of trimesh's own ray objects.

>>> import trimesh
>>> from octrace.trimesh_ray import RayMeshIntersector
>>> mesh = trimesh.load("bunny.obj")
>>> mesh.ray = RayMeshIntersector(mesh)
>>> mesh.ray.intersects_first([[0, 0.1, 1]], [[0, 0, -1]])
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from . import NO_FACE, Octree, from_arrays

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

__all__ = ["RayMeshIntersector"]


class RayMeshIntersector:
    """Answers rays for a mesh. Coordinates are used as float32; which triangles those hit is exact, so there is no scale and no offset to choose."""

    def __init__(self, geometry: Any, octree: Octree | None = None):
        """geometry: a ``trimesh.Trimesh``, or anything with ``vertices`` and ``faces``. octree: its octree, if there is one already; else it is built,
        and built again when the mesh has changed."""
        self.mesh = geometry
        self._octree = octree
        self._made_of = None

    def _rays(self) -> Octree:
        hashed = getattr(self.mesh, "__hash__", None)
        state = hash(self.mesh) if hashed is not None else None
        if self._octree is None or (self._made_of is not None and self._made_of != state):
            self._octree = from_arrays(self.mesh.vertices, self.mesh.faces)
            self._made_of = state
        return self._octree

    def intersects_location(
        self, ray_origins: ArrayLike, ray_directions: ArrayLike, multiple_hits: bool = True
    ) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
        """Where rays meet the mesh: locations (m, 3), index_ray (m,), index_tri (m,)."""
        index_tri, index_ray, locations = self.intersects_id(
            ray_origins, ray_directions, multiple_hits=multiple_hits, return_locations=True
        )
        return locations, index_ray, index_tri

    def intersects_id(
        self,
        ray_origins: ArrayLike,
        ray_directions: ArrayLike,
        multiple_hits: bool = True,
        max_hits: int | None = None,
        return_locations: bool = False,
    ) -> tuple[Any, ...]:
        """The triangles that rays hit: index_tri (m,), index_ray (m,), and locations (m, 3) if asked for. With `multiple_hits` all of a ray's hits, at
        most `max_hits`, nearest first; else the nearest."""
        origins, directions = _both(ray_origins, ray_directions)
        octree = self._rays()
        if multiple_hits:
            ray, t, face, _, _ = octree.intersect_all(origins, directions, max_hits=max_hits)
        else:
            t, face, _, _ = octree.intersect(origins, directions)
            ray = np.flatnonzero(face != NO_FACE)
            t, face = t[ray], face[ray]
        face = face.astype(np.int64)
        if not return_locations:
            return face, ray
        locations = origins[ray].astype(np.float64) + directions[ray].astype(np.float64) * t[:, None].astype(np.float64)
        return face, ray, locations

    def intersects_first(self, ray_origins: ArrayLike, ray_directions: ArrayLike) -> NDArray[np.int64]:
        """The triangle that each ray hits first, (n,); -1 for a miss."""
        _, face, _, _ = self._rays().intersect(*_both(ray_origins, ray_directions))
        return np.where(face == NO_FACE, np.int64(-1), face.astype(np.int64))

    def intersects_any(self, ray_origins: ArrayLike, ray_directions: ArrayLike) -> NDArray[np.bool_]:
        """Whether each ray hits the mesh at all, (n,)."""
        return self._rays().occluded(*_both(ray_origins, ray_directions))

    def contains_points(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Whether points lie within the mesh, which must be watertight: a ray from each crosses it an odd number of times. Exact: no ray slips
        through an edge, so one direction is enough."""
        points = np.ascontiguousarray(np.asanyarray(points, dtype=np.float32).reshape((-1, 3)))
        directions = np.broadcast_to(np.array([0.4395064455, 0.617598629942, 0.652231566745], dtype=np.float32), points.shape)
        ray, *_ = self._rays().intersect_all(points, directions)
        return np.bincount(ray, minlength=len(points)) % 2 == 1


def _both(origins: ArrayLike, directions: ArrayLike) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Both as float32, (n, 3); copied only where they are something else."""
    origins, directions = (np.asanyarray(a, dtype=np.float32).reshape((-1, 3)) for a in (origins, directions))
    if origins.shape != directions.shape:
        raise ValueError(f"{len(origins)} origins, but {len(directions)} directions")
    return origins, directions
