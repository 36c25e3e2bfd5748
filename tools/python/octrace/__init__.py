"""Exact ray tracing of triangle meshes larger than memory.

>>> import numpy as np, octrace
>>> octrace.build("bunny.obj", "bunny.oct")                      # once; any size, within a bound of memory
>>> bunny = octrace.Octree.open("bunny.oct")
>>> t, face, u, v = bunny.intersect([[0, 0.1, 1]], [[0, 0, -1]])

Which triangle a ray hits is decided as in exact arithmetic on the stored coordinates; ``t`` is the correctly rounded value.
"""

from ._octrace import (
    DamagedError,
    Error,
    InputError,
    MachineError,
    Octree,
    __version__,
    build,
    from_arrays,
)

NO_FACE = 0xFFFFFFFF
"""The face of a ray that hits nothing."""

__all__ = ["DamagedError", "Error", "InputError", "MachineError", "NO_FACE", "Octree", "__version__", "build", "from_arrays"]
