"""The octree from Python."""

import threading

import numpy as np
import pytest

import octrace


def test_a_triangle_is_hit_where_it_is():
    one = octrace.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    t, face, u, v = one.intersect([[0.25, 0.5, 2], [2, 2, 2]], [[0, 0, -4], [0, 0, -4]])
    assert (t.dtype, face.dtype, u.dtype) == (np.float32, np.uint32, np.float32)
    assert t.tolist() == [0.5, np.inf] and face.tolist() == [0, octrace.NO_FACE]
    assert (u[0], v[0]) == (0.25, 0.5)
    assert one.occluded([[0.25, 0.5, 2]], [[0, 0, -4]]).tolist() == [True]
    assert one.occluded([[0.25, 0.5, 2]], [[0, 0, -4]], tmax=0.25).tolist() == [False]
    assert one.intersect([[0.25, 0.5, 2]] * 2, [[0, 0, -4]] * 2, tmin=np.array([0, 0.75], np.float32))[1].tolist() == [0, octrace.NO_FACE]
    assert len(one) == 1 and one.source_triangles == 1
    assert one.bounds.tolist() == [[0, 0, 0], [1, 1, 0]]


def test_hits_lie_on_their_triangles(bunny, bunny_obj, chords):
    vertices, faces = [], []
    for line in bunny_obj.read_text().splitlines():
        words = line.split()
        if words[:1] == ["v"]:
            vertices.append([float(x) for x in words[1:4]])
        elif words[:1] == ["f"]:
            faces.append([int(word.split("/")[0]) - 1 for word in words[1:4]])
    corners = np.array(vertices)[np.array(faces)]
    origins, directions = chords(bunny.bounds, 20_000)
    t, face, u, v = bunny.intersect(origins, directions)
    hit = face != octrace.NO_FACE
    assert 0.05 < hit.mean() < 0.9
    a, b, c = np.moveaxis(corners[face[hit]], 1, 0)
    weights = np.stack([1 - u[hit] - v[hit], u[hit], v[hit]])[:, :, None]
    on_triangle = (weights * np.stack([a, b, c])).sum(axis=0)
    on_ray = origins[hit] + directions[hit] * t[hit, None]
    assert np.abs(on_triangle - on_ray).max() < 1e-6
    assert (bunny.occluded(origins, directions) == hit).all()
    # All hits: the first of each ray is the closest, and t rises.
    ray, all_t, all_face, _, _ = bunny.intersect_all(origins, directions)
    first = np.flatnonzero(np.diff(ray, prepend=-1))
    assert (ray[first] == np.flatnonzero(hit)).all() and (all_face[first] == face[hit]).all()
    assert (all_t[first] == t[hit]).all() and (np.diff(all_t)[np.diff(ray) == 0] >= 0).all()
    few = bunny.intersect_all(origins, directions, max_hits=1)
    assert (few[0] == np.flatnonzero(hit)).all()


def test_arrays_of_other_kinds_are_taken(bunny, chords):
    origins, directions = chords(bunny.bounds, 3000)
    right = bunny.intersect(origins, directions)
    wide = np.zeros((3000, 8), np.float32)
    wide[:, ::2][:, :3] = origins
    for other in (origins.astype(np.float64), origins.tolist(), np.asfortranarray(origins), wide[:, ::2][:, :3]):
        assert all((a == b).all() for a, b in zip(bunny.intersect(other, directions), right))
    assert all(len(column) == 0 for column in bunny.intersect(np.zeros((0, 3)), np.zeros((0, 3))))


def test_wrong_arguments_are_told(bunny, tmp_path):
    with pytest.raises(ValueError, match=r"not \(n, 3\)"):
        bunny.intersect(np.zeros((3, 4)), np.zeros((3, 4)))
    with pytest.raises(ValueError, match="2 origins, but 3"):
        bunny.intersect(np.zeros((2, 3)), np.zeros((3, 3)))
    with pytest.raises(ValueError, match="tmax has 2"):
        bunny.intersect(np.zeros((3, 3)), np.ones((3, 3)), tmax=np.zeros(2, np.float32))
    with pytest.raises(octrace.MachineError, match="no_such.oct"):
        octrace.Octree.open(tmp_path / "no_such.oct")
    (tmp_path / "text.oct").write_text("not an octree file at all")
    with pytest.raises(octrace.InputError):
        octrace.Octree.open(tmp_path / "text.oct")
    with pytest.raises(octrace.InputError):
        octrace.build(tmp_path / "text.oct", tmp_path / "x.oct")
    with pytest.raises(ValueError, match="vertex 3 of 3"):
        octrace.from_arrays(np.eye(3), [[0, 1, 3]])
    with pytest.raises(ValueError, match="no size"):
        octrace.build(tmp_path / "a.obj", tmp_path / "x.oct", memory="lots")
    assert issubclass(octrace.InputError, ValueError) and issubclass(octrace.MachineError, OSError)


def test_damage_is_told(bunny, tmp_path):
    data = bytearray(open(bunny.path, "rb").read())
    data[len(data) // 2] ^= 1
    (tmp_path / "damaged.oct").write_bytes(data)
    damaged = octrace.Octree.open(tmp_path / "damaged.oct")
    bounds = damaged.bounds
    grid = np.stack(np.meshgrid(*np.linspace(bounds[0], bounds[1], 60).T[:2]), axis=-1).reshape(-1, 2)
    origins = np.column_stack([grid, np.full(len(grid), bounds[1, 2] + 1)])
    with pytest.raises(octrace.DamagedError, match="page"):
        damaged.intersect_all(origins, np.broadcast_to([0, 0, -1], origins.shape))


def test_builds_tell_how_far_they_are_and_can_be_stopped(bunny_obj, tmp_path):
    told = []
    report = octrace.build(bunny_obj, tmp_path / "a.oct", memory="256M", threads=1, progress=lambda *args: told.append(args))
    assert report["triangles"] == 69451 and sum(report["dropped"].values()) == 0
    phases = [phase for phase, _ in told]
    assert phases[0] == "scan" and "stitch" in phases
    assert all(share is None or 0 <= share <= 1 for _, share in told)

    def enough(*_):
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        octrace.build(bunny_obj, tmp_path / "b.oct", progress=enough)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.oct"]


def test_other_threads_run_meanwhile(bunny, chords):
    origins, directions = chords(bunny.bounds, 300_000)
    right = bunny.intersect(origins, directions)[0]
    answers, ticks, stop = [], [0], threading.Event()

    def tick():
        while not stop.wait(0.001):
            ticks[0] += 1

    ticker = threading.Thread(target=tick)
    ticker.start()
    tracers = [threading.Thread(target=lambda: answers.append(bunny.intersect(origins, directions)[0])) for _ in range(3)]
    [thread.start() for thread in tracers]
    [thread.join() for thread in tracers]
    stop.set()
    ticker.join()
    assert len(answers) == 3 and all((answer == right).all() for answer in answers)
    assert ticks[0] > 5, "the interpreter was held"
