"""The octree from Python: rays in arrays, hits in arrays."""

import multiprocessing
import pathlib
import signal
import threading
import time
import tracemalloc

import numpy as np
import pytest
from conftest import chords, read_obj

import octrace


def triangle():
    return octrace.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])


def test_a_triangle_is_hit_where_it_is():
    one = triangle()
    t, face, u, v = one.intersect([[0.25, 0.5, 2], [2, 2, 2]], [[0, 0, -4], [0, 0, -4]])
    assert (t.dtype, face.dtype, u.dtype, v.dtype) == (np.float32, np.uint32, np.float32, np.float32)
    assert t.tolist() == [0.5, np.inf] and face.tolist() == [0, octrace.NO_FACE]
    assert (u[0], v[0]) == (0.25, 0.5)
    assert one.occluded([[0.25, 0.5, 2]], [[0, 0, -4]]).tolist() == [True]
    assert len(one) == 1 and one.source_triangles == 1
    assert one.bounds.tolist() == [[0, 0, 0], [1, 1, 0]] and one.bounds.dtype == np.float32
    assert repr(one) == "<octrace.Octree in a temporary file: 1 triangles>" and one.path is None


def test_intervals_are_for_all_rays_or_one_each():
    one, rays = triangle(), ([[0.25, 0.5, 2]] * 2, [[0, 0, -4]] * 2)
    for tmax in (0.25, np.float64(0.25), np.array(0.25), [0.25, 0.25], np.full(2, 0.25)):
        assert one.occluded(*rays, tmax=tmax).tolist() == [False, False]
    assert one.occluded(*rays, tmin=0.5, tmax=0.5).tolist() == [True, True]
    assert one.intersect(*rays, tmin=np.array([0, 0.75]))[1].tolist() == [0, octrace.NO_FACE]
    assert one.intersect(*rays, 0, np.array([9, 1, 0.25, 1], np.float32)[::2])[1].tolist() == [0, octrace.NO_FACE]
    assert one.intersect_all(*rays, [0.75, 0])[0].tolist() == [1]


def test_hits_lie_on_their_triangles(bunny, bunny_obj):
    vertices, faces = read_obj(bunny_obj)
    assert len(bunny) == bunny.source_triangles == len(faces)
    origins, directions = chords(bunny.bounds, 20_000)
    t, face, u, v = bunny.intersect(origins, directions)
    hit = face != octrace.NO_FACE
    assert 0.05 < hit.mean() < 0.9
    assert np.isinf(t[~hit]).all() and not u[~hit].any() and not v[~hit].any()
    a, b, c = np.moveaxis(vertices[faces[face[hit]]], 1, 0)
    weights = np.stack([1 - u[hit] - v[hit], u[hit], v[hit]])[:, :, None]
    on_triangle = (weights * np.stack([a, b, c])).sum(axis=0)
    on_ray = origins[hit] + directions[hit] * t[hit, None]
    assert np.abs(on_triangle - on_ray).max() < 1e-6
    assert (bunny.occluded(origins, directions) == hit).all()


def test_all_hits_begin_with_the_closest_and_are_even(bunny):
    origins, directions = chords(bunny.bounds, 20_000)
    t, face, u, v = bunny.intersect(origins, directions)
    hit = np.flatnonzero(face != octrace.NO_FACE)
    ray, *all_of = bunny.intersect_all(origins, directions)
    assert [ray.dtype] + [column.dtype for column in all_of] == [np.int64, np.float32, np.uint32, np.float32, np.float32]
    first = np.flatnonzero(np.diff(ray, prepend=-1))
    assert (ray[first] == hit).all()
    for some, one in zip(all_of, (t, face, u, v)):
        assert (some[first] == one[hit]).all()
    assert (np.diff(all_of[0])[np.diff(ray) == 0] >= 0).all()
    # A chord begins and ends outside. The bunny has holes at its base, so a few rays leave through one.
    counts = np.bincount(ray, minlength=len(origins))
    assert counts.max() >= 6 and (counts % 2 == 1).mean() < 0.05
    for most in (0, 1, 3):
        few = bunny.intersect_all(origins, directions, max_hits=most)
        assert (np.bincount(few[0], minlength=len(origins)) == np.minimum(counts, most)).all()
        kept = np.concatenate([np.arange(n) for n in counts[counts > 0]]) < most
        assert (few[2] == all_of[1][kept]).all()


def test_arrays_of_other_kinds_are_taken(bunny):
    origins, directions = chords(bunny.bounds, 3000)
    right = bunny.intersect(origins, directions)
    wide = np.zeros((6000, 8), np.float32)
    wide[::2, 1:4] = origins
    odd = np.frombuffer(b"." + origins.tobytes(), np.uint8)[1:].view(np.float32).reshape(-1, 3)
    backward = np.ascontiguousarray(origins[::-1, ::-1])[::-1, ::-1]
    swapped = origins.astype(">f4")
    frozen = origins.copy()
    frozen.flags.writeable = False
    kinds = (origins.astype(np.float64), origins.tolist(), np.asfortranarray(origins), wide[::2, 1:4], odd, backward, swapped, frozen)
    for other in kinds:
        assert all((a == b).all() for a, b in zip(bunny.intersect(other, directions), right))
        assert (bunny.occluded(other, directions) == (right[1] != octrace.NO_FACE)).all()
    assert all(len(column) == 0 for column in bunny.intersect(np.zeros((0, 3)), np.zeros((0, 3))))
    # One origin, or one direction, for all.
    center = bunny.bounds.mean(axis=0)
    same = np.broadcast_to(center, directions.shape)
    assert (bunny.intersect(center, directions)[1] == bunny.intersect(same.copy(), directions)[1]).all()
    assert (bunny.intersect(same, directions)[0] == bunny.intersect(same.copy(), directions)[0]).all()
    assert (bunny.intersect(origins, directions[0])[1] == bunny.intersect(origins, np.tile(directions[0], (3000, 1)))[1]).all()
    assert bunny.intersect(origins[0], directions[0])[1].tolist() == right[1][:1].tolist()


def test_float32_is_not_copied(bunny):
    n = 1 << 20
    origins, directions = chords(bunny.bounds, n)

    def peak(*arrays):
        tracemalloc.start()
        bunny.intersect(*arrays)
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return most

    assert 16 * n <= peak(origins, directions) < 17 * n  # the answer alone
    assert 16 * n <= peak(origins[::-1], directions) < 17 * n
    assert 28 * n <= peak(origins.astype(np.float64), directions) < 29 * n


def test_wrong_arguments_are_told(bunny):
    for shape in ((3, 4), (3, 3, 3), (4,), ()):
        with pytest.raises(ValueError, match=r"origins has the shape .*, not \(n, 3\) or \(3,\)"):
            bunny.intersect(np.zeros(shape), np.zeros((3, 3)))
    with pytest.raises(ValueError, match="2 origins, but 3 directions"):
        bunny.intersect(np.zeros((2, 3)), np.zeros((3, 3)))
    with pytest.raises(ValueError, match=r"tmax has the shape \[2\]; for 3 rays that is \(\) or \(3,\)"):
        bunny.intersect(np.zeros((3, 3)), np.ones((3, 3)), tmax=np.zeros(2, np.float32))
    with pytest.raises((TypeError, ValueError)):
        bunny.intersect("origins", np.ones((3, 3)))
    with pytest.raises(TypeError):
        octrace.Octree()


def test_errors_are_exceptions_with_the_librarys_messages(bunny, tmp_path):
    with pytest.raises(octrace.MissingError, match="no_such.oct: cannot open"):
        octrace.Octree.open(tmp_path / "no_such.oct")
    (tmp_path / "text.oct").write_text("not an octree file at all")
    with pytest.raises(octrace.InputError, match="text.oct"):
        octrace.Octree.open(str(tmp_path / "text.oct"))
    assert issubclass(octrace.InputError, ValueError) and issubclass(octrace.MachineError, OSError)
    assert issubclass(octrace.MissingError, FileNotFoundError) and issubclass(octrace.MissingError, octrace.InputError)
    for error in (octrace.InputError, octrace.DamagedError, octrace.MachineError):
        assert issubclass(error, octrace.Error)


@pytest.mark.parametrize("memory", [None, "64M"])
def test_damage_is_told(bunny, tmp_path, memory):
    data = bytearray(bunny.path.read_bytes())
    data[len(data) // 2] ^= 1
    (tmp_path / "damaged.oct").write_bytes(data)
    damaged = octrace.Octree.open(tmp_path / "damaged.oct", memory=memory)
    origins, directions = chords(damaged.bounds, 1000)
    for ask in (damaged.intersect, damaged.occluded, damaged.intersect_all):
        with pytest.raises(octrace.DamagedError, match="damaged.oct: damaged octree file, page"):
            ask(origins, directions)


@pytest.mark.parametrize("compress", [None, 3])
def test_within_a_bound_of_memory_the_answers_are_the_same(terrain, tmp_path, compress):
    vertices, faces = terrain
    octrace.from_arrays(vertices, faces[::8], tmp_path / "mapped.oct")
    plain = octrace.Octree.open(tmp_path / "mapped.oct")
    small = plain
    if compress:
        # Packed pages are always read within a bound.
        ply(tmp_path / "mesh.ply", vertices, faces[::8])
        octrace.build(tmp_path / "mesh.ply", tmp_path / "packed.oct", compress=compress)
        small = octrace.Octree.open(tmp_path / "packed.oct")
        assert small.path.stat().st_size < plain.path.stat().st_size
    bounded = octrace.Octree.open(small.path, memory="6M")
    origins, directions = chords(plain.bounds, 60_000)
    for octree in (small, bounded):
        for kind in ("intersect", "occluded", "intersect_all"):
            asked, told = (getattr(file, kind)(origins, directions) for file in (plain, octree))
            assert np.array_equal(np.vstack(asked), np.vstack(told))
    with pytest.raises(octrace.InputError, match="memory is too small for this file: the least is .M"):
        octrace.Octree.open(small.path, memory=1e6)


def ply(path, vertices, faces):
    """Writes a binary PLY file."""
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\nproperty float x\nproperty float y\nproperty float z\n"
    head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    rows = np.empty(len(faces), dtype=[("n", "u1"), ("corners", "<i4", 3)])
    rows["n"], rows["corners"] = 3, faces
    path.write_bytes(head.encode() + vertices.astype("<f4").tobytes() + rows.tobytes())


def test_other_threads_run_meanwhile(bunny):
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


def test_a_forked_process_traces_too(bunny):
    origins, directions = chords(bunny.bounds, 50_000)
    right = bunny.intersect(origins, directions)[1]
    context = multiprocessing.get_context("fork")
    result = context.SimpleQueue()
    child = context.Process(target=lambda: result.put((bunny.intersect(origins, directions)[1] == right).all()), daemon=True)
    child.start()
    child.join(60)
    assert child.exitcode == 0 and result.get()


def test_ctrl_c_stops_a_long_query(bunny):
    direction = np.broadcast_to(np.array([0, 0, -1], np.float32), (400_000_000, 3))
    start = time.monotonic()
    timer = threading.Timer(0.2, lambda: signal.raise_signal(signal.SIGINT))
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        bunny.occluded(bunny.bounds.mean(axis=0), direction)
    timer.join()
    assert time.monotonic() - start < 20


def test_a_temporary_file_goes_with_its_octree(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    one = triangle()
    assert one.occluded([0.25, 0.5, 2], [0, 0, -4]).tolist() == [True]
    del one
    assert list(tmp_path.iterdir()) == []
    kept = octrace.from_arrays(np.eye(3), [[0, 1, 2]], tmp_path / "kept.oct")
    assert kept.path == pathlib.Path(tmp_path / "kept.oct") and kept.path.exists()
    assert repr(kept) == f'<octrace.Octree "{kept.path}": 1 triangles>'
