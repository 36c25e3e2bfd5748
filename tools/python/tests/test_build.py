"""Building octree files from Python."""

import logging
import signal
import threading
import time
import warnings

import numpy as np
import pytest
from conftest import read_obj

import octrace


def test_a_file_is_the_same_from_a_mesh_file_and_from_arrays(bunny, bunny_obj, tmp_path):
    vertices, faces = read_obj(bunny_obj)
    for name, kind in (("a", np.int64), ("b", np.int32), ("c", np.uint32)):
        made = octrace.from_arrays(vertices, faces.astype(kind), tmp_path / name, memory="128M", threads=1)
        assert made.path.read_bytes() == bunny.path.read_bytes()


def test_progress_rises_and_the_report_tells(bunny_obj, tmp_path):
    told, threads = [], set()

    def progress(phase, share):
        told.append((phase, share))
        threads.add(threading.current_thread())

    report = octrace.build(bunny_obj, tmp_path / "a.oct", memory="256M", threads=1, progress=progress)
    assert report["triangles"] == report["source_triangles"] == 69451 and sum(report["dropped"].values()) == 0
    assert report["bytes"] == (tmp_path / "a.oct").stat().st_size and report["pages"] == 1 and report["vertices"] > 30_000
    assert report["bytes_per_triangle"] == report["bytes"] / report["triangles"] and 0 < report["seconds"] < 60
    phases = [phase for phase, _ in told]
    assert phases[0] == "scan" and phases[-1] == "stitch"
    shares = [share for _, share in told]
    assert shares == sorted(shares) and shares[0] == 0 and 0.9 < shares[-1] <= 1
    assert threads == {threading.current_thread()}


def test_what_progress_raises_ends_the_build(bunny_obj, tmp_path):
    calls = []

    def enough(*_):
        calls.append(1)
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        octrace.build(bunny_obj, tmp_path / "b.oct", progress=enough)
    assert len(calls) == 1 and list(tmp_path.iterdir()) == []


def test_ctrl_c_ends_a_build(terrain, tmp_path):
    timer = threading.Timer(0.3, lambda: signal.raise_signal(signal.SIGINT))
    timer.start()
    start = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        octrace.from_arrays(*terrain, tmp_path / "a.oct")
    timer.join()
    assert time.monotonic() - start < 20 and list(tmp_path.iterdir()) == []


def test_faults_of_a_mesh_are_errors_or_warnings(tmp_path):
    bad = tmp_path / "bad.obj"
    bad.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 2 9\n")
    with pytest.raises(octrace.InputError, match=r"bad.obj:5:"):
        octrace.build(bad, tmp_path / "a.oct")
    report = octrace.build(bad, tmp_path / "a.oct", lenient=True)
    assert report["triangles"] == 1 and report["dropped"]["bad_index"] == 1
    painted = tmp_path / "painted.obj"
    painted.write_text("mtllib none.mtl\nusemtl red\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.warns(octrace.BuildWarning) as warned:
        octrace.build(painted, tmp_path / "a.oct")
    assert any("none.mtl" in str(warning.message) for warning in warned) and {warning.filename for warning in warned} == {__file__}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(octrace.BuildWarning):
            octrace.build(painted, tmp_path / "b.oct")
    assert not (tmp_path / "b.oct").exists()


def test_large_coordinates_are_moved_to_an_origin(tmp_path):
    mesh = tmp_path / "map.obj"
    mesh.write_text("v 450000.25 5400000.25 0\nv 450001.25 5400000.25 0\nv 450000.25 5400001.25 0\nf 1 2 3\n")
    octrace.build(mesh, tmp_path / "map.oct", origin=(450000, 5400000, 0))
    octree = octrace.Octree.open(tmp_path / "map.oct")
    assert octree.origin.tolist() == [450000, 5400000, 0] and octree.bounds.tolist() == [[0.25, 0.25, 0], [1.25, 1.25, 0]]


def test_options_are_heard(bunny, bunny_obj, tmp_path):
    plain = bunny.path.stat().st_size
    for options in ({"ids": False}, {"lod": False}, {"compress": 3}):
        octrace.build(bunny_obj, tmp_path / "a.oct", **options)
        assert (tmp_path / "a.oct").stat().st_size < plain, options
    (tmp_path / "temp").mkdir()
    with pytest.warns(octrace.BuildWarning, match="no unfinished build"):
        octrace.build(bunny_obj, tmp_path / "a.oct", temp=tmp_path / "temp", resume=True, memory=1 << 27)
    assert (tmp_path / "a.oct").read_bytes() == bunny.path.read_bytes()
    with pytest.raises(octrace.MachineError, match="no_such"):
        octrace.build(bunny_obj, tmp_path / "no_such" / "a.oct")


def test_wrong_arguments_are_told(bunny_obj, tmp_path):
    out = tmp_path / "x.oct"
    with pytest.raises(octrace.MissingError, match="no_such.obj"):
        octrace.build(tmp_path / "no_such.obj", out)
    with pytest.raises(octrace.InputError, match="not a mesh format"):
        octrace.build(tmp_path / "a.txt", out)
    for size in ("lots", "M", "1.5.1M", "64Q", "-1M", -1, float("nan")):
        with pytest.raises(octrace.InputError, match="is no (size|number of bytes)"):
            octrace.build(bunny_obj, out, memory=size)
    with pytest.raises(octrace.InputError, match="at least 64 MiB"):
        octrace.build(bunny_obj, out, memory="10M")
    with pytest.raises(octrace.InputError, match="levels 1 to 22"):
        octrace.build(bunny_obj, out, compress=23)
    with pytest.raises(octrace.InputError, match="same file"):
        octrace.build(bunny_obj, bunny_obj)
    for corner in (3, -1):
        with pytest.raises(octrace.InputError, match=f"vertex {corner} of 3"):
            octrace.from_arrays(np.eye(3), [[0, 1, corner]])
    with pytest.raises(TypeError, match="whole numbers"):
        octrace.from_arrays(np.eye(3), [[0, 1, 2.5]])
    with pytest.raises(octrace.InputError, match=r"shapes \[3, 3\] and \[1, 4\]"):
        octrace.from_arrays(np.eye(3), [[0, 1, 2, 0]])
    assert list(tmp_path.iterdir()) == []


def test_notes_go_to_the_log(tmp_path, caplog):
    mesh = tmp_path / "long.obj"
    mesh.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n" + "# a remark\n" * 4_000_000)
    with caplog.at_level(logging.INFO, "octrace"):
        octrace.build(mesh, tmp_path / "a.oct", memory="64M")
    assert "temporary files will lie in" in caplog.text
