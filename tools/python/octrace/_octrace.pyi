"""The part of the package that is written in Rust."""

from collections.abc import Callable
from os import PathLike
from typing import Any, Optional, Union

import numpy as np
from numpy.typing import ArrayLike, NDArray

__version__: str

class Error(Exception):
    """Something that octrace cannot do; the base of its other exceptions."""

class InputError(Error, ValueError):
    """Input or an argument is at fault."""

class DamagedError(Error):
    """An octree file is damaged."""

class MachineError(Error, OSError):
    """The machine failed: disk, permission, input or output."""

class Octree:
    """An octree file, opened. Its methods may be called from several threads at once; they use all cores and let other Python threads run."""

    @staticmethod
    def open(path: Union[str, PathLike[str]]) -> Octree:
        """Opens an octree file, which takes the same time whatever its size: pages are read when rays first touch them."""

    def intersect(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        tmin: Union[float, NDArray[np.float32]] = 0.0,
        tmax: Union[float, NDArray[np.float32]] = ...,
    ) -> tuple[NDArray[np.float32], NDArray[np.uint32], NDArray[np.float32], NDArray[np.float32]]:
        """The closest hit of each ray.

        origins, directions: (n, 3), used as float32 (arrays of that type are not copied). tmin, tmax: closed interval of t, one for all or (n,).
        Returns t, face, u, v, each (n,): the hit lies at origin + t * direction = (1 - u - v) a + u b + v c. A miss: t = inf, face = NO_FACE.
        """

    def occluded(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        tmin: Union[float, NDArray[np.float32]] = 0.0,
        tmax: Union[float, NDArray[np.float32]] = ...,
    ) -> NDArray[np.bool_]:
        """Whether anything lies on each ray between tmin and tmax; faster than `intersect`."""

    def intersect_all(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        tmin: Union[float, NDArray[np.float32]] = 0.0,
        tmax: Union[float, NDArray[np.float32]] = ...,
        max_hits: Optional[int] = None,
    ) -> tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.uint32], NDArray[np.float32], NDArray[np.float32]]:
        """All hits of each ray, by ray and then by t; at most `max_hits` of a ray. Returns ray, t, face, u, v, each (m,)."""

    @property
    def bounds(self) -> NDArray[np.float32]:
        """Lowest and highest corner of all triangles, (2, 3)."""

    @property
    def path(self) -> str:
        """The file's path as it was given."""

    @property
    def source_triangles(self) -> int:
        """Faces of the source, those left out included; face numbers are below."""

    def __len__(self) -> int:
        """The number of triangles."""

def build(
    mesh: Union[str, PathLike[str]],
    octree: Union[str, PathLike[str]],
    *,
    memory: Union[int, str] = "1G",
    threads: Optional[int] = None,
    compress: Optional[int] = None,
    lenient: bool = False,
    ids: bool = True,
    progress: Optional[Callable[[str, Optional[float]], Any]] = None,
) -> dict[str, Any]:
    """Builds an octree file from an OBJ, PLY or STL file (also .gz and .zst) within `memory` (bytes, or text like "512M").

    progress(phase, share) is called now and then; share is 0 to 1, or None where it is not known. What it raises ends the build. Returns what was built:
    triangles, vertices, dropped, bytes, bytes_per_triangle, pages.
    """

def from_arrays(vertices: ArrayLike, faces: ArrayLike, octree: Optional[Union[str, PathLike[str]]] = None) -> Octree:
    """Builds an octree from arrays, vertices (n, 3) as float32 and faces (m, 3), and opens it. Without a path it lives in a temporary file
    that goes with it."""
