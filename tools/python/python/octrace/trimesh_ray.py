"""Rays against a trimesh mesh, by octrace: the methods of trimesh's own ray objects.

>>> import trimesh
>>> from octrace.trimesh_ray import RayMeshIntersector
>>> mesh = trimesh.load_mesh("bunny.obj", process=False)
>>> mesh.ray = RayMeshIntersector(mesh)
>>> mesh.ray.intersects_first([[0, 0.1, 1]], [[0, 0, -1]])
array([35231])
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from . import NO_FACE, Octree, from_arrays

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

__all__ = ["RayMeshIntersector"]

_FAR = 16.0
"""From how many times its size away from the origin on a mesh is moved there: float32 would lose more than four bits of its shape."""


class RayMeshIntersector:
    """Answers rays for a mesh.

    Coordinates are rounded to float32 and used as they are then; which triangles are hit is exact for these. A mesh that is far from the
    origin for its size (maps, cities) is moved there first, and the rays with it.
    """

    def __init__(self, geometry: Any, octree: Octree | None = None):
        """geometry: a ``trimesh.Trimesh``, or anything with ``vertices`` and ``faces``. octree: the octree of it, if there is one already;
        without it one is built when rays first come, and again when the mesh has changed."""
        self.mesh = geometry
        self._given = octree
        self._octree: Octree | None = octree
        self._state: int | None = None
        self._shift: NDArray[np.float64] | None = None
        if octree is not None and octree.origin.any():
            self._shift = octree.origin

    def _rays(self) -> Octree:
        """The octree of the mesh as it is now."""
        if self._given is not None:
            return self._given
        state = hash(self.mesh)
        if self._octree is None or self._state != state:
            vertices = np.asarray(self.mesh.vertices)
            low, high = vertices.min(axis=0), vertices.max(axis=0)
            far = max(np.abs(low).max(), np.abs(high).max()) > _FAR * (high - low).max()
            self._shift = (low + high) / 2 if far else None
            if self._shift is not None:
                vertices = vertices - self._shift
            self._octree = from_arrays(vertices, self.mesh.faces)
            self._state = state
        return self._octree

    def _query(self, origins: ArrayLike, directions: ArrayLike) -> tuple[Octree, NDArray[np.float32], NDArray[np.float32]]:
        """The octree, and rays in its frame as float32, (n, 3)."""
        octree = self._rays()
        starts, ways = np.asanyarray(origins), np.asanyarray(directions)
        if starts.shape != ways.shape:
            raise ValueError("Ray origin and direction don't match!")
        if self._shift is not None:
            starts = starts - self._shift
        if ways.dtype != np.float32:
            # Brought into float32's range by a power of two, which leaves the line as it is.
            ways = np.asarray(ways, dtype=np.float64).reshape((-1, 3))
            longest = np.abs(ways).max(axis=1, initial=0, keepdims=True)
            ways = np.ldexp(ways, -np.frexp(np.where(np.isfinite(longest), longest, 0))[1])
        return octree, _points(starts), _points(ways)

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
        """The triangles that rays hit: index_tri (m,), index_ray (m,), and if asked for locations (m, 3), by ray and then by distance.

        With `multiple_hits` all of a ray's hits, the nearest `max_hits` if that is given; else the nearest."""
        octree, origins, directions = self._query(ray_origins, ray_directions)
        if multiple_hits:
            index_ray, t, face, _, _ = octree.intersect_all(origins, directions, max_hits=max_hits)
        else:
            t, face, _, _ = octree.intersect(origins, directions)
            index_ray = np.flatnonzero(face != NO_FACE)
            t, face = t[index_ray], face[index_ray]
        index_tri = face.astype(np.int64)
        if not return_locations:
            return index_tri, index_ray
        locations = origins[index_ray] + directions[index_ray] * t[:, None].astype(np.float64)
        if self._shift is not None:
            locations += self._shift
        return index_tri, index_ray, locations

    def intersects_first(self, ray_origins: ArrayLike, ray_directions: ArrayLike) -> NDArray[np.int64]:
        """The triangle that each ray hits first, (n,); -1 for a miss."""
        octree, origins, directions = self._query(ray_origins, ray_directions)
        _, face, _, _ = octree.intersect(origins, directions)
        return np.where(face == NO_FACE, np.int64(-1), face.astype(np.int64))

    def intersects_any(self, ray_origins: ArrayLike, ray_directions: ArrayLike) -> NDArray[np.bool_]:
        """Whether each ray hits the mesh at all, (n,)."""
        octree, origins, directions = self._query(ray_origins, ray_directions)
        return octree.occluded(origins, directions)

    def contains_points(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Whether points lie within the mesh, (n,). The mesh must be watertight.

        A ray from each point crosses the mesh an odd number of times; none slips through an edge, so one direction is enough. Undefined
        for points on the surface."""
        octree, origins, _ = self._query(points, points)
        index_ray, *_ = octree.intersect_all(origins, np.array([0.43950644, 0.61759863, 0.65223157], np.float32))
        return np.bincount(index_ray, minlength=len(origins)) % 2 == 1

    def __reduce__(self) -> tuple[Any, ...]:
        # An octree file that was given must be given again by whoever unpickles this.
        return RayMeshIntersector, (self.mesh,)

    def __copy__(self) -> RayMeshIntersector:
        return RayMeshIntersector(self.mesh, self._given)

    def __deepcopy__(self, *_: Any) -> RayMeshIntersector:
        return self.__copy__()


def _points(array: NDArray[Any]) -> NDArray[np.float32]:
    """As float32, (n, 3); copied only if it is something else."""
    return np.asanyarray(array, dtype=np.float32).reshape((-1, 3))
