#!/bin/sh
# Draws a whole frame with octrender and with the Embree harness in turn, and prints how many times as fast octrender is.
#
#   tests/peers/frame.sh OUT [ROUNDS [THREADS]]      5 rounds and 2 threads if not given
#
# The same rays on both sides: planet_10m over, 1024 x 1024, one mirror bounce, a shadow ray at each hit that faces the light. Parsing,
# building, opening and writing the picture are left out on both sides; but octrender checks each page when it first uses it, in
# the frame's time, while the harness has drawn a frame before. `wall` is the clock's ratio, `cpu` that of the processor's seconds of all
# threads: the one to read on a machine that others work on.
#
# Wants octbuild and octrender on the path, a C and a C++ compiler, and Embree 3 (apt-get install libembree-dev). MESH names another
# planet (planet_1m); EMBREE other options of the harness ("--quality medium --robust").
set -eu
peers=$(cd "$(dirname "$0")" && pwd)
out=${1:?usage: frame.sh OUT [ROUNDS [THREADS]]}
rounds=${2:-5}
threads=${3:-2}
mesh=${MESH:-planet_10m}
mkdir -p "$out"
cd "$out"
[ -x embree_trace ] || g++ -O3 -march=native -std=c++17 -DEMBREE3 -o embree_trace "$peers/embree_trace.cpp" -lembree3 -pthread
[ -x meshgen ] || cc -O3 -march=native -o meshgen "$peers/meshgen.c" -lm
case $mesh in
planet_1m) [ -f $mesh.obj ] || ./meshgen -n 1e6 -o $mesh.obj ;;
planet_10m) [ -f $mesh.obj ] || ./meshgen -n 1e7 -o $mesh.obj ;;
esac
[ -f "$mesh.oct" ] || octbuild "$mesh.obj" -o "$mesh.oct" -q

cat > frame.txt <<END
resolution 1024 1024
lookat 2.5 2.08 2.6  0 0 0  0 1 0
fov 40
depth 1
background 0.25 0.3 0.4
amblight 0.08
light 8 6 -1 1
mat diff 0.7 0.7 0.7
mat spec 0.25 0.25 0.25
shininess 32
local 0.75
reflect 0.25
oct $mesh.oct
END

# The harness keeps its mesh and answers a line with a line.
rm -f asks answers
mkfifo asks answers
# shellcheck disable=SC2086
./embree_trace "$mesh.obj" --eye 2.5 2.08 2.6 --look 0 0 0 --up 0 1 0 --fov 40 --light 8 6 -1 \
    ${EMBREE:---quality high} --serve < asks > answers &
harness=$!
trap 'kill $harness 2> /dev/null || true; rm -f asks answers' EXIT
exec 3> asks 4< answers
while read -r line <&4; do
    case $line in *'"peer"'*) echo "octrender beside ${line#*:}" && break ;; esac
done
number() { sed -n "s/.*\"$1\": *\([0-9.e-]*\).*/\1/p"; }
peer() { echo "frame $threads" >&3 && read -r line <&4 && echo "$line"; }
own() { octrender -q frame.txt -o frame.png --threads "$threads" --stats frame.json; }
# A round of each to warm up.
peer > /dev/null
own
: > ratios
for _ in $(seq "$rounds"); do
    answer=$(peer)
    own
    echo "$(echo "$answer" | number frame) $(echo "$answer" | number cpu)" \
        "$(number trace_seconds < frame.json) $(number trace_cpu_seconds < frame.json)" |
        awk '{ printf "%.3f %.3f  Embree %.0f ms (cpu %.0f), octrender %.0f ms (cpu %.0f)\n", $1 / $3, $2 / $4, 1e3 * $1, 1e3 * $2, 1e3 * $3, 1e3 * $4 }' |
        tee -a ratios
done
median() { sort -n | awk '{ x[NR] = $1 } END { print (x[int((NR + 1) / 2)] + x[int(NR / 2) + 1]) / 2 }'; }
echo "median of $rounds rounds: wall $(cut -d' ' -f1 ratios | median), cpu $(cut -d' ' -f2 ratios | median)"
