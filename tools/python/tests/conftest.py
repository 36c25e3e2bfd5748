"""Meshes and rays for the tests."""

import pathlib

import numpy as np
import pytest

import octrace

ROOT = pathlib.Path(__file__).parents[3]


def read_obj(path):
    """Vertices as float64 and faces of an OBJ file of triangles."""
    vertices, faces = [], []
    for line in path.read_text().splitlines():
        words = line.split()
        if words[:1] == ["v"]:
            vertices.append([float(x) for x in words[1:4]])
        elif words[:1] == ["f"]:
            faces.append([int(word.split("/")[0]) - 1 for word in words[1:4]])
    return np.array(vertices), np.array(faces)


def chords(bounds, n, seed=1):
    """Random chords of the sphere around a box."""
    random = np.random.default_rng(seed)
    center, radius = bounds.mean(axis=0), np.linalg.norm(bounds[1] - bounds[0]) / 2
    ends = random.normal(size=(2, n, 3))
    ends = center + radius * ends / np.linalg.norm(ends, axis=2, keepdims=True)
    return ends[0].astype(np.float32), (ends[1] - ends[0]).astype(np.float32)


@pytest.fixture(scope="session")
def bunny_obj():
    return ROOT / "assets" / "bunny.obj"


@pytest.fixture(scope="session")
def bunny(bunny_obj, tmp_path_factory):
    path = tmp_path_factory.mktemp("bunny") / "bunny.oct"
    octrace.build(bunny_obj, path)
    return octrace.Octree.open(path)


@pytest.fixture(scope="session")
def terrain():
    """Vertices and faces of two million triangles, which take a while to build."""
    side = 1001
    x, y = np.meshgrid(np.arange(side, dtype=np.float32), np.arange(side, dtype=np.float32))
    z = np.random.default_rng(5).random((side, side), dtype=np.float32)
    at = np.arange(side * side).reshape(side, side)
    a, b, c, d = (part.ravel() for part in (at[:-1, :-1], at[:-1, 1:], at[1:, 1:], at[1:, :-1]))
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    return np.column_stack([x.ravel(), y.ravel(), z.ravel()]), faces
