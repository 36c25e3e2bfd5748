"""The exceptions of octrace, and its warning."""

__all__ = ["BuildWarning", "DamagedError", "Error", "InputError", "MachineError", "MissingError"]


class Error(Exception):
    """Something that octrace cannot do; the base of its other exceptions."""


class InputError(Error, ValueError):
    """A file or an argument is at fault."""


class MissingError(InputError, FileNotFoundError):
    """There is no such file."""


class DamagedError(Error):
    """An octree file is damaged."""


class MachineError(Error, OSError):
    """The machine failed: disk, permission, input or output."""


class BuildWarning(UserWarning):
    """A mesh is not as it should be, but was built."""
