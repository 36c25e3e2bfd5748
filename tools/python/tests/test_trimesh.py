"""The methods of trimesh's ray objects, against trimesh with its Embree backend on a real mesh."""

import numpy as np
import pytest

import octrace

trimesh = pytest.importorskip("trimesh")
pytest.importorskip("embreex")
from octrace.trimesh_ray import RayMeshIntersector  # noqa: E402


@pytest.fixture(scope="module")
def mesh(bunny_obj):
    return trimesh.load(bunny_obj, process=False)


@pytest.fixture(scope="module")
def ours(mesh):
    return RayMeshIntersector(mesh)


@pytest.fixture(scope="module")
def rays(mesh, chords):
    return chords(np.asarray(mesh.bounds, np.float32), 20_000, seed=7)


def near_an_edge(mesh, face, origin, direction):
    """How near to an edge, in barycentric coordinates, the line passes in the triangle's plane, in f64."""
    a, b, c = np.asarray(mesh.vertices, np.float32).astype(float)[mesh.faces[face]]
    origin, direction = origin.astype(float), direction.astype(float)
    matrix = np.column_stack([b - a, c - a, -direction])
    u, v, _ = np.linalg.solve(matrix, origin - a)
    return min(abs(u), abs(v), abs(1 - u - v))


def test_first_and_any(mesh, ours, rays):
    origins, directions = rays
    first = ours.intersects_first(origins, directions)
    theirs = mesh.ray.intersects_first(origins, directions)
    assert first.dtype.kind == "i" and first.shape == theirs.shape
    differ = np.flatnonzero(first != theirs)
    # Ours is exact; theirs slips where the ray passes an edge within its rounding. Each difference must be one of these.
    assert len(differ) < 20
    for i in differ:
        faces = [face for face in (first[i], theirs[i]) if face >= 0]
        assert faces and min(near_an_edge(mesh, face, origins[i], directions[i]) for face in faces) < 1e-4, i
    anything = ours.intersects_any(origins, directions)
    assert (anything == (first >= 0)).all()
    assert (anything != mesh.ray.intersects_any(origins, directions)).sum() <= len(differ)


def test_locations_and_ids(mesh, ours, rays):
    origins, directions = (column[:4000] for column in rays)
    for multiple in (False, True):
        locations, ray, face = ours.intersects_location(origins, directions, multiple_hits=multiple)
        theirs = mesh.ray.intersects_location(origins, directions, multiple_hits=multiple)
        mine = {(int(r), int(f)): p for r, f, p in zip(ray, face, locations)}
        yours = {(int(r), int(f)): p for p, r, f in zip(*theirs)}
        assert len(mine) == len(ray), "each triangle once for a ray"
        for key in mine.keys() & yours.keys():
            assert np.abs(mine[key] - yours[key]).max() < 1e-5
        odd = mine.keys() ^ yours.keys()
        assert len(odd) < 0.01 * len(mine)
        for r, f in odd:
            # Embree goes on a little behind each hit, so it misses layers that are close together; else the ray passes an edge.
            close = [k for k in mine.keys() | yours.keys() if k[0] == r and k[1] != f]
            gap = min((np.linalg.norm((mine.get(k, yours.get(k))) - mine.get((r, f), yours.get((r, f)))) for k in close), default=1.0)
            assert near_an_edge(mesh, f, origins[r], directions[r]) < 1e-3 or gap < 2e-3, (r, f)
    index_tri, index_ray = ours.intersects_id(origins, directions, multiple_hits=True, max_hits=1)
    assert (index_tri == ours.intersects_id(origins, directions, multiple_hits=False)[0]).all() and len(index_ray) == len(set(index_ray))


def test_a_mesh_that_changes_is_built_again():
    mesh = trimesh.creation.box()
    ray = RayMeshIntersector(mesh)
    assert ray.intersects_any([[5, 0.1, 0.2]], [[0, 0, -1]]).tolist() == [False]
    mesh.apply_translation([5, 0, -3])
    assert ray.intersects_any([[5, 0.1, 0.2]], [[0, 0, -1]]).tolist() == [True]


def test_points_inside():
    mesh = trimesh.creation.icosphere(subdivisions=3)
    ray = RayMeshIntersector(mesh)
    points = np.random.default_rng(3).uniform(-1.2, 1.2, (2000, 3))
    radius = np.linalg.norm(points, axis=1)
    inside = ray.contains_points(points)
    assert inside[radius < 0.98].all() and not inside[radius > 1].any()
    assert octrace.NO_FACE == 2**32 - 1
