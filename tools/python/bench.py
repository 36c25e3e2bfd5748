"""Rays per second from Python beside octtrace's, in turn, on the same file and rays.

    python tools/python/bench.py OCTTRACE MESH [--rays 1000000] [--rounds 5] [--threads N] [--clock cpu]

OCTTRACE is the program (target/release/octtrace), MESH an OBJ, PLY, STL or octree file. octtrace's speed is the one that it tells of
itself with --stats and --repeat: tracing alone, without reading and writing rays. Python's is that of whole calls of `intersect`, with the
arrays that it makes. Prints medians of rounds, of which each has three calls and three repeats, and their ratio; ends with 1 if one is below
0.9. With --clock cpu processor time is measured, of Python's calls, and of eight more repeats of octtrace: for a machine that is in use.
"""

import argparse
import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("octtrace", type=pathlib.Path)
parser.add_argument("mesh", type=pathlib.Path)
parser.add_argument("--rays", type=int, default=1_000_000)
parser.add_argument("--rounds", type=int, default=5)
parser.add_argument("--threads", type=int, default=0, help="of both, 0 = all cores")
parser.add_argument("--clock", choices=["wall", "cpu"], default="wall")
arguments = parser.parse_args()
if arguments.threads:
    os.environ["RAYON_NUM_THREADS"] = str(arguments.threads)

import numpy as np  # noqa: E402

import octrace  # noqa: E402


def chords(bounds, n):
    """Random chords of the sphere around a box: rays that have nothing to do with each other."""
    random = np.random.default_rng(1)
    center, radius = bounds.mean(axis=0), np.linalg.norm(bounds[1] - bounds[0]) / 2
    ends = random.normal(size=(2, n, 3))
    ends = center + radius * ends / np.linalg.norm(ends, axis=2, keepdims=True)
    return ends[0].astype(np.float32), (ends[1] - ends[0]).astype(np.float32)


def camera(bounds, n):
    """A camera's rays, row by row."""
    side = int(n**0.5)
    center, radius = bounds.mean(axis=0), np.linalg.norm(bounds[1] - bounds[0]) / 2
    x, y = np.meshgrid(np.linspace(-1, 1, side), np.linspace(1, -1, side))
    directions = np.stack([x, y, np.full_like(x, -3)], axis=-1).reshape(-1, 3).astype(np.float32)
    origins = np.broadcast_to((center + [0, 0, 3 * radius]).astype(np.float32), directions.shape).copy()
    return origins, directions


def python_seconds(octree, origins, directions):
    """The median of three calls, and the answer."""
    clock, seconds = time.process_time if arguments.clock == "cpu" else time.perf_counter, []
    for _ in range(3):
        start = clock()
        answer = octree.intersect(origins, directions)
        seconds.append(clock() - start)
    return statistics.median(seconds), answer


def run_octtrace(path, folder, repeat):
    """Processor time, and what it told."""
    command = [arguments.octtrace, path, "-q", "--repeat", str(repeat), "--stats", folder / "stats.json"]
    if arguments.threads:
        command += ["--threads", str(arguments.threads)]
    before = os.times()
    with open(folder / "rays.bin", "rb") as rays, open(folder / "hits.bin", "wb") as hits:
        subprocess.run(command, stdin=rays, stdout=hits, check=True)
    after = os.times()
    cpu = after.children_user + after.children_system - before.children_user - before.children_system
    return cpu, json.loads((folder / "stats.json").read_text())["trace_seconds"]


def octtrace_seconds(path, folder):
    """Of one repeat; and the hits."""
    if arguments.clock == "cpu":
        seconds = (run_octtrace(path, folder, 10)[0] - run_octtrace(path, folder, 2)[0]) / 8
    else:
        seconds = statistics.median(run_octtrace(path, folder, 3)[1])
    hits = np.fromfile(folder / "hits.bin", dtype=[("t", "<f4"), ("face", "<u4"), ("u", "<f4"), ("v", "<f4")])
    return seconds, hits


def compare(name, octree, path, folder, origins, directions):
    """The ratio of the speeds."""
    n = len(origins)
    ends = np.tile(np.array([0, np.inf], np.float32), (n, 1))
    np.hstack([origins, directions, ends]).astype("<f4").tofile(folder / "rays.bin")
    ours, theirs = [], []
    for _ in range(arguments.rounds):
        seconds, answer = python_seconds(octree, origins, directions)
        ours.append(seconds)
        seconds, hits = octtrace_seconds(path, folder)
        theirs.append(seconds)
        for column, name_of in zip(answer, ("t", "face", "u", "v")):
            assert (column == hits[name_of]).all(), f"{name_of} differs from octtrace's"
    python, program = (n / statistics.median(seconds) * 1e-6 for seconds in (ours, theirs))
    print(f"{name:8} {python:8.2f} {program:10.2f} {python / program:8.3f}   {(answer[1] != octrace.NO_FACE).mean():.0%} hit")
    return python / program


with tempfile.TemporaryDirectory() as name:
    folder = pathlib.Path(name)
    path = arguments.mesh
    if path.suffix != ".oct":
        path = folder / "mesh.oct"
        octrace.build(arguments.mesh, path)
    octree = octrace.Octree.open(path)
    print(f"{octree!r}, medians of {arguments.rounds} in turn\nMrays/s    Python   octtrace    ratio")
    ratios = [
        compare(kind.__name__, octree, path, folder, *kind(octree.bounds, arguments.rays)) for kind in (chords, camera)
    ]
sys.exit(min(ratios) < 0.9)
