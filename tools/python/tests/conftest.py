"""Meshes for the tests."""

import pathlib

import numpy as np
import pytest

import octrace

ASSETS = pathlib.Path(__file__).parents[3] / "assets"


@pytest.fixture(scope="session")
def bunny_obj():
    return ASSETS / "bunny.obj"


@pytest.fixture(scope="session")
def bunny(bunny_obj, tmp_path_factory):
    path = tmp_path_factory.mktemp("bunny") / "bunny.oct"
    octrace.build(bunny_obj, path)
    return octrace.Octree.open(path)


@pytest.fixture(scope="session")
def chords():
    """A function that gives n random chords of the sphere around a box."""

    def make(bounds, n, seed=1):
        random = np.random.default_rng(seed)
        center = bounds.mean(axis=0)
        radius = np.linalg.norm(bounds[1] - bounds[0]) / 2
        ends = random.normal(size=(2, n, 3))
        ends = center + radius * ends / np.linalg.norm(ends, axis=2, keepdims=True)
        return ends[0].astype(np.float32), (ends[1] - ends[0]).astype(np.float32)

    return make
