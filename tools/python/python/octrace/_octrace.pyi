"""The part of the package octrace that is written in Rust."""

from collections.abc import Callable
from os import PathLike
from pathlib import Path
from typing import Any, Optional, TypedDict, Union, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Octree", "__version__", "build", "from_arrays"]

__version__: str

@final
class Octree:
    """An octree file, opened.

    Its methods may be called from several threads at once; each uses all cores and lets other Python threads run.
    """

    @staticmethod
    def open(path: Union[str, PathLike[str]], *, memory: Optional[Union[float, str]] = None) -> Octree:
        """Opens an octree file, which takes the same time whatever its size: pages are read when rays first need them.

        Without ``memory`` the file is mapped, and memory is the system's care (a packed file gets half of what is free). With it, pages
        and the rays that wait for them take at most so many bytes (a number, or text like "512M"), beside the arrays of a call.
        """

    def intersect(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        tmin: Optional[ArrayLike] = None,
        tmax: Optional[ArrayLike] = None,
    ) -> tuple[NDArray[np.float32], NDArray[np.uint32], NDArray[np.float32], NDArray[np.float32]]:
        """The closest hit of each ray: t, face, u, v, each (n,).

        origins, directions: (n, 3), or (3,) for all rays the same; used as float32, and where they lie if they are that. tmin, tmax:
        the closed interval of t, for all rays or one each; 0 and infinity if not given. The hit lies at
        origin + t * direction = (1 - u - v) a + u b + v c, with the corners a, b, c of the face. A miss has t = inf and face = NO_FACE.
        """

    def occluded(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        tmin: Optional[ArrayLike] = None,
        tmax: Optional[ArrayLike] = None,
    ) -> NDArray[np.bool_]:
        """Whether anything lies on each ray between tmin and tmax, (n,): faster than ``intersect``, whose arguments these are."""

    def intersect_all(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        tmin: Optional[ArrayLike] = None,
        tmax: Optional[ArrayLike] = None,
        *,
        max_hits: Optional[int] = None,
    ) -> tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.uint32], NDArray[np.float32], NDArray[np.float32]]:
        """All hits of each ray, by ray and then by t: ray, t, face, u, v, each (m,).

        Of each ray at most ``max_hits``, the nearest. The other arguments are those of ``intersect``.
        """

    @property
    def bounds(self) -> NDArray[np.float32]:
        """Lowest and highest corner of all triangles, (2, 3)."""

    @property
    def origin(self) -> NDArray[np.float64]:
        """The point that was subtracted from the mesh's coordinates when the file was built, (3,): rays are in that frame."""

    @property
    def path(self) -> Optional[Path]:
        """The file's path as it was given; None if the octree has a temporary file of its own."""

    @property
    def source_triangles(self) -> int:
        """The number of triangles of the source, those that were left out among them; face numbers are below."""

    def __len__(self) -> int:
        """The number of triangles."""

class _Dropped(TypedDict):
    degenerate: int
    non_finite: int
    bad_index: int
    too_few_corners: int

class _Report(TypedDict):
    triangles: int
    source_triangles: int
    vertices: int
    dropped: _Dropped
    bytes: int
    bytes_per_triangle: float
    pages: int
    seconds: float

def build(
    mesh: Union[str, PathLike[str]],
    octree: Union[str, PathLike[str]],
    *,
    memory: Optional[Union[float, str]] = None,
    threads: Optional[int] = None,
    temp: Optional[Union[str, PathLike[str]]] = None,
    resume: bool = False,
    lenient: bool = False,
    origin: Optional[tuple[float, float, float]] = None,
    compress: Optional[int] = None,
    ids: bool = True,
    lod: bool = True,
    progress: Optional[Callable[[str, float], Any]] = None,
) -> _Report:
    """Builds an octree file from an OBJ, PLY or STL file, also .gz and .zst; returns what was built.

    memory: what this process may take in all, in bytes or as text like "512M", at least 64M; if not given, 1G more than it has taken.
    What does not fit goes to temporary files in ``temp`` (the output's folder if not given). threads: how many, all cores if not given.
    resume: go on where a build of the same mesh to the same file was killed. lenient: skip faces with a bad index and lines that cannot
    be read. origin: a point that is subtracted from all coordinates before they become float32. compress: level, 1 to 22, to pack pages
    with zstd. ids, lod: False leaves out face numbers, what level of detail needs.

    progress(phase, share) is called as work goes on, share rising from 0 to 1; what it raises ends the build, as Ctrl-C does. Faults of
    the mesh that do not stop the build are warnings (``octrace.BuildWarning``).
    """

def from_arrays(
    vertices: ArrayLike,
    faces: ArrayLike,
    octree: Optional[Union[str, PathLike[str]]] = None,
    *,
    memory: Optional[Union[float, str]] = None,
    threads: Optional[int] = None,
    progress: Optional[Callable[[str, float], Any]] = None,
) -> Octree:
    """Builds an octree of a mesh in arrays and opens it.

    vertices: (n, 3), used as float32. faces: (m, 3) integers, from 0 on. octree: the file to write; without it the octree has a
    temporary file, which goes with it. The other arguments are those of ``build``.
    """
