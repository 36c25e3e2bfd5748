"""Exact ray tracing of triangle meshes larger than memory.

>>> import octrace
>>> report = octrace.build("bunny.obj", "bunny.oct")  # once; any size, within a bound of memory
>>> bunny = octrace.Octree.open("bunny.oct")
>>> t, face, u, v = bunny.intersect([[0, 0.1, 1]], [[0, 0, -1]])
>>> face
array([35231], dtype=uint32)

Which triangle a ray hits is decided as in exact arithmetic on the coordinates stored, and ``t`` is the float32 nearest to the true value.
"""

from ._octrace import Octree, __version__, build, from_arrays
from .errors import BuildWarning, DamagedError, Error, InputError, MachineError, MissingError

NO_FACE = 0xFFFFFFFF
"""The face of a ray that hits nothing."""

__all__ = [
    "BuildWarning",
    "DamagedError",
    "Error",
    "InputError",
    "MachineError",
    "MissingError",
    "NO_FACE",
    "Octree",
    "__version__",
    "build",
    "from_arrays",
]
