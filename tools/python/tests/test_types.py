"""The type stubs: they fit what is there, and a typed program passes."""

import subprocess
import sys

import pytest

pytest.importorskip("mypy")

PROGRAM = """
import numpy as np
from numpy.typing import NDArray
import octrace
from octrace.trimesh_ray import RayMeshIntersector

def depth(octree: octrace.Octree, eye: tuple[float, float, float], rays: NDArray[np.float64]) -> NDArray[np.float32]:
    t, face, u, v = octree.intersect(eye, rays, tmax=10)
    faces: NDArray[np.uint32] = face
    return t

report = octrace.build("a.obj", "a.oct", memory="512M", progress=lambda phase, share: print(phase, f"{share:.0%}"))
bytes_of: int = report["bytes"] + report["dropped"]["degenerate"]
size: int = len(octrace.Octree.open("a.oct", memory=1 << 28))
"""


def mypy(*arguments, cwd):
    return subprocess.run([sys.executable, "-m", *arguments], cwd=cwd, capture_output=True, text=True)


def test_a_typed_program_passes(tmp_path):
    (tmp_path / "program.py").write_text(PROGRAM)
    (tmp_path / "wrong.py").write_text(PROGRAM + "\noctrace.build('a.obj')\nt: int = octrace.Octree.open('a.oct').occluded(1, 2)\n")
    right = mypy("mypy", "--strict", "program.py", cwd=tmp_path)
    assert right.returncode == 0, right.stdout
    wrong = mypy("mypy", "--strict", "wrong.py", cwd=tmp_path)
    assert wrong.stdout.count("error:") == 2, wrong.stdout


def test_the_stubs_are_what_is_there(tmp_path):
    done = mypy("mypy.stubtest", "octrace", "--ignore-disjoint-bases", cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
