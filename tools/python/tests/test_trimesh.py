"""The methods of trimesh's ray objects, against trimesh with its Embree backend on a real mesh; exact arithmetic judges where they differ."""

import collections
import copy
import pickle

import numpy as np
import pytest
from conftest import chords
from exact import Judge

import octrace

trimesh = pytest.importorskip("trimesh")
pytest.importorskip("embreex")
from octrace.trimesh_ray import RayMeshIntersector  # noqa: E402

# What Embree's float32 can shift a ray by, in sizes of the mesh: its coordinates are scaled to 100, where float32 has steps of 8e-6.
ROUNDING = 1e-6
# What trimesh steps forward behind a hit (ray_pyembree.py), in sizes of the mesh; twice as much each time that it meets the same face again.
STEP = 1e-6


@pytest.fixture(scope="module")
def mesh(bunny_obj):
    mesh = trimesh.load_mesh(bunny_obj, process=False)
    assert type(mesh.ray).__module__ == "trimesh.ray.ray_pyembree", "trimesh does not use Embree"
    return mesh


@pytest.fixture(scope="module")
def ours(mesh):
    return RayMeshIntersector(mesh)


@pytest.fixture(scope="module")
def judge(mesh):
    return Judge(np.asarray(mesh.vertices, np.float32)[mesh.faces])


@pytest.fixture(scope="module")
def rays(mesh, judge):
    """Rays of no plan, and rays aimed at vertices and at edges."""
    bounds = np.asarray(mesh.bounds, np.float32)
    origins, directions = chords(bounds, 20_600, seed=7)
    random = np.random.default_rng(8)
    corners = judge.corners[random.integers(len(judge.corners), size=600)]
    share = random.random((600, 1), dtype=np.float32) * (np.arange(600) % 2)[:, None]
    directions[20_000:] = corners[:, 0] + share * (corners[:, 1] - corners[:, 0]) - origins[20_000:]
    return origins, directions


def test_first_and_any(mesh, ours, judge, rays):
    origins, directions = rays
    first, theirs = ours.intersects_first(origins, directions), mesh.ray.intersects_first(origins, directions)
    assert first.dtype == np.int64 and first.shape == theirs.shape
    reasons = collections.Counter()
    for i in np.flatnonzero(first != theirs):
        hits = judge.hits(origins[i], directions[i])
        assert_first(hits, first[i])
        nearest = [face for t, face, _ in hits if t == hits[0][0]]
        faces = {int(first[i]), int(theirs[i])} - {-1}
        clearance = min(judge.clearance(face, origins[i], directions[i]) for face in faces)
        assert clearance < ROUNDING * mesh.scale, (i, first[i], theirs[i])
        kind = "aimed" if i >= 20_000 else "of no plan"
        reasons[kind, "Embree names the other triangle of an edge" if theirs[i] in nearest[1:] else
                "Embree passes between triangles" if theirs[i] == -1 else
                "Embree hits an outline that the ray passes by" if first[i] == -1 else
                "Embree takes the wrong side of an edge"] += 1
    print(*(f"{count:6} of the rays {kind}: {why}" for (kind, why), count in sorted(reasons.items())), sep="\n")
    assert sum(count for (kind, _), count in reasons.items() if kind == "of no plan") < 20
    anything = ours.intersects_any(origins, directions)
    assert anything.dtype == np.bool_ and (anything == (first >= 0)).all()
    differ = np.flatnonzero(anything != mesh.ray.intersects_any(origins, directions))
    assert set(differ) <= set(np.flatnonzero(first != theirs))


@pytest.mark.parametrize("multiple", [False, True])
def test_locations(mesh, ours, judge, rays, multiple):
    origins, directions = (column[:20_300] for column in rays)
    locations, index_ray, index_tri = ours.intersects_location(origins, directions, multiple_hits=multiple)
    theirs = mesh.ray.intersects_location(origins, directions, multiple_hits=multiple)
    assert [a.dtype for a in (locations, index_ray, index_tri)] == [np.float64, np.int64, np.int64]
    mine, yours = table(index_ray, index_tri, locations), table(theirs[1], theirs[2], theirs[0])
    assert len(mine) == len(index_ray), "each triangle once for a ray"
    assert_same_places(mesh, judge, origins, directions, mine, yours)
    assert_same_faces(mesh, judge, origins, directions, mine.keys(), yours.keys(), multiple)


@pytest.mark.parametrize("multiple", [False, True])
def test_ids(mesh, ours, judge, rays, multiple):
    origins, directions = (column[:20_300] for column in rays)
    # Without places trimesh takes another way to single hits, and drops no grazing ray.
    mine, yours = (by.intersects_id(origins, directions, multiple_hits=multiple) for by in (ours, mesh.ray))
    assert [(a.dtype, a.ndim) for a in mine] == [(np.int64, 1)] * 2 and len(yours) == 2
    pairs, theirs = (set(zip(index_ray.tolist(), index_tri.tolist())) for index_tri, index_ray in (mine, yours))
    assert len(pairs) == len(mine[0]), "each triangle once for a ray"
    assert_same_faces(mesh, judge, origins, directions, pairs, theirs, multiple)
    placed, theirs = (by.intersects_id(origins, directions, multiple_hits=multiple, return_locations=True) for by in (ours, mesh.ray))
    assert len(placed) == 3 and all(np.array_equal(a, b) for a, b in zip(mine, placed)) and len(placed[2]) == len(pairs)
    placed, theirs = (table(index_ray, index_tri, locations) for index_tri, index_ray, locations in (placed, theirs))
    assert_same_places(mesh, judge, origins, directions, placed, theirs)


def assert_same_places(mesh, judge, origins, directions, mine, yours):
    """Hits that both name are in the same place, unless the ray grazes the triangle."""
    both = mine.keys() & yours.keys()
    assert len(both) > 2500
    grazing = 0
    for ray, face in both:
        apart = np.abs(mine[ray, face] - yours[ray, face]).max() / mesh.scale
        if apart > 1e-6:
            # The ray grazes the triangle; ours is off by no more than the rounding of t.
            t = float(depth_of(judge.hits(origins[ray], directions[ray]), face))
            exact = origins[ray].astype(float) + directions[ray].astype(float) * t
            off, wide = (np.abs(hits[ray, face] - exact).max() / mesh.scale for hits in (mine, yours))
            assert off < 1e-7 < wide, (ray, face, off, wide)
            grazing += 1
    assert grazing < 100


def assert_same_faces(mesh, judge, origins, directions, mine, yours, multiple):
    """The pairs of a ray and a triangle are the same, or there is a reason; rays of no plan seldom need one."""
    assert len(mine & yours) > 2500
    reasons = collections.Counter()
    for ray in sorted({ray for ray, _ in mine ^ yours}):
        why = reason(judge, mesh.scale, origins[ray], directions[ray], *(of_ray(hits, ray) for hits in (mine, yours)), multiple)
        reasons["aimed" if ray >= 20_000 else "of no plan", why] += 1
    print(*(f"{count:6} of the rays {kind}: {why}" for (kind, why), count in sorted(reasons.items())), sep="\n")
    assert sum(count for (kind, _), count in reasons.items() if kind == "of no plan") < 100


def assert_first(hits, face):
    """The face is the nearest of the exact hits (-1: there are none). Where a ray passes an edge or a corner exactly, those triangles may be left
    out that it only touches."""
    skipped = [hit for hit in hits if face == -1 or hit[0] < depth_of(hits, face)]
    assert all(on_edge for *_, on_edge in skipped) and (face == -1 or face in {face for _, face, _ in hits}), (face, hits)


def depth_of(hits, face):
    return next((t for t, other, _ in hits if other == face), np.inf)


def table(rays, faces, locations):
    return {(int(ray), int(face)): place for ray, face, place in zip(rays, faces, locations)}


def of_ray(hits, ray):
    return {face for other, face in hits if other == ray}


def reason(judge, scale, origin, direction, mine, yours, multiple):
    """Why the faces that Embree names for a ray are others; fails if ours are not the exact ones, or if there is no reason."""
    hits = judge.hits(origin, direction)
    if multiple:
        exact, edges = {face for _, face, _ in hits}, {face for _, face, on_edge in hits if on_edge}
        assert mine <= exact and exact - mine <= edges, "ours are not the exact hits"
    else:
        assert_first(hits, *(mine or {-1}))
    odd = mine ^ yours
    edge = {face for face in odd if judge.clearance(face, origin, direction) < ROUNDING * scale}
    length = np.linalg.norm(direction.astype(float))
    layers = {
        face
        for face in odd & mine
        for t, other, _ in hits
        if other != face and abs(t - depth_of(hits, face)) * length < 4 * STEP * scale
    }
    # With one wrong face the nearest is another one.
    assert odd <= edge | layers or (edge and not multiple), (odd, edge, layers)
    return "Embree's rounding decides at an edge" if edge else "trimesh steps over a layer that is close behind another"


def test_ids_by_ray_and_distance(ours, rays):
    origins, directions = (column[:5000] for column in rays)
    index_tri, index_ray = ours.intersects_id(origins, directions)
    assert len(index_ray) > len(set(index_ray)) and (np.diff(index_ray) >= 0).all()
    for most in ({"max_hits": 1}, {"multiple_hits": False}):
        near_tri, near_ray = ours.intersects_id(origins, directions, **most)
        first = np.flatnonzero(np.diff(index_ray, prepend=-1))
        assert (near_ray == index_ray[first]).all() and (near_tri == index_tri[first]).all()
    with pytest.raises(ValueError, match="don't match"):
        ours.intersects_first(np.zeros((2, 3)), np.zeros((3, 3)))


def test_a_mesh_takes_it_for_its_own():
    mesh = trimesh.creation.box()
    mesh.ray = RayMeshIntersector(mesh)
    assert mesh.contains([[0, 0, 0], [0, 0, 2]]).tolist() == [True, False]
    for other in (copy.copy(mesh.ray), copy.deepcopy(mesh.ray), pickle.loads(pickle.dumps(mesh.ray))):
        assert other.intersects_any([[0.1, 0.2, 5]], [[0, 0, -1]]).tolist() == [True]


def test_a_mesh_that_changes_is_built_again():
    mesh = trimesh.creation.box()
    ray = RayMeshIntersector(mesh)
    assert ray.intersects_any([[5, 0.1, 0.2]], [[0, 0, -1]]).tolist() == [False]
    before = ray._octree
    assert ray.intersects_any([[0.2, 0.1, 2]], [[0, 0, -1]]).tolist() == [True] and ray._octree is before
    mesh.apply_translation([5, 0, -3])
    assert ray.intersects_any([[5, 0.1, 0.2]], [[0, 0, -1]]).tolist() == [True]


def test_a_mesh_far_away_keeps_its_shape():
    mesh = trimesh.creation.icosphere(subdivisions=3)
    near = RayMeshIntersector(mesh.copy())
    origins, directions = (column.astype(np.float64) for column in chords(mesh.bounds, 2000))
    right = near.intersects_location(origins, directions)
    there = np.array([450_000.0, 5_400_000.0, 1e6])
    mesh.apply_translation(there)
    far = RayMeshIntersector(mesh).intersects_location(origins + there, directions)
    same = np.array_equal(right[1], far[1]) and np.array_equal(right[2], far[2])
    assert same and np.abs(right[0] + there - far[0]).max() < 1e-6


def test_directions_of_any_length_are_taken(ours, rays):
    origins, directions = (column[:2000] for column in rays)
    right = ours.intersects_first(origins, directions)
    for scale in (1e-200, 1e200):
        assert (ours.intersects_first(origins, directions * np.float64(scale)) == right).all()
    assert (ours.intersects_first(origins, directions * np.float64(0)) == -1).all()


def test_an_octree_that_is_there_is_taken(bunny, mesh, rays):
    given = RayMeshIntersector(mesh, bunny)
    origins, directions = (column[:2000] for column in rays)
    assert (given.intersects_any(origins, directions) == bunny.occluded(origins, directions)).all()
    assert given._octree is bunny and octrace.NO_FACE == 2**32 - 1


def test_points_inside():
    mesh = trimesh.creation.icosphere(subdivisions=3)
    ray = RayMeshIntersector(mesh)
    points = np.random.default_rng(3).uniform(-1.2, 1.2, (2000, 3))
    radius = np.linalg.norm(points, axis=1)
    inside = ray.contains_points(points)
    assert inside[radius < 0.98].all() and not inside[radius > 1].any()
    assert (inside == mesh.ray.contains_points(points)).all()
