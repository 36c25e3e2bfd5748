#!/bin/sh
# Measures again what README.md and docs/SPEED.md show, in the folder OUT (made if need be), with Embree beside.
#
#   tests/peers/figures.sh OUT [CLOCK]      CLOCK: wall (default), or cpu on a machine that others work on
#
# Wants octbuild and octbench on the path, a C and a C++ compiler, and Embree 3 (apt-get install libembree-dev).
# MESHES names what is measured: "bunny planet_1m planet_10m" by default; planets need about a gigabyte for each 10 million triangles.
# For `kitchen` (architecture: thin and huge triangles) put kitchen.obj into OUT: assets/kitchen.obj.zst, unpacked, of the crate obvhs 0.4.0.
set -eu
peers=$(cd "$(dirname "$0")" && pwd)
out=${1:?usage: figures.sh OUT [CLOCK]}
clock=${2:-wall}
mkdir -p "$out"
cd "$out"
[ -x embree_trace ] || g++ -O3 -march=native -std=c++17 -DEMBREE3 -o embree_trace "$peers/embree_trace.cpp" -lembree3 -pthread
[ -x meshgen ] || cc -O3 -march=native -o meshgen "$peers/meshgen.c" -lm
cp "$peers/../../assets/bunny.obj" .
files=
for mesh in ${MESHES:-bunny planet_1m planet_10m}; do
    case $mesh in
    planet_1m) [ -f $mesh.obj ] || ./meshgen -n 1e6 -o $mesh.obj ;;
    planet_10m) [ -f $mesh.obj ] || ./meshgen -n 1e7 -o $mesh.obj ;;
    esac
    octbuild $mesh.obj -o $mesh.oct -q
    case $mesh in
    kitchen) views="--view kitchen-outside --view kitchen-inside" ;;
    *) views="--view ${mesh%%_*}-over --view ${mesh%%_*}-close" ;;
    esac
    octbench speed $mesh.oct $views --clock "$clock" --stats $mesh.json \
        --peer-command "./embree_trace $mesh.obj --serve --quality high" \
        --peer-command "./embree_trace $mesh.obj --serve --quality medium --robust"
    files="$files $mesh.json"
done
octbench figures $files > speed.md
octbench tradeoff --model bunny.obj --planet 1e5 --clock "$clock" -o tradeoff --stats tradeoff.json --markdown \
    --peer-command './embree_trace {mesh} --serve --quality high' \
    --peer-command './embree_trace {mesh} --serve --quality medium --robust' > tradeoff.md
echo "tables: $out/speed.md $out/tradeoff.md; plot: $out/tradeoff.svg $out/tradeoff.png"
