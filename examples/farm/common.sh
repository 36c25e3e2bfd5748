# What try-slurm and try-parallel share: a scene, the picture that one process makes of it, and the comparison.
# Sourced.

shares=${SHARES:-8}
slots=${SLOTS:-$(nproc)}

die() {
    echo "$0: $*" >&2
    exit 1
}

need() {
    for tool; do
        command -v "$tool" >/dev/null || die "$tool is missing${hint:+: $hint}"
    done
}

now() {
    date +%s.%N
}

# The scene given, or one that has to be built first.
scene_of() {
    if [ $# -gt 0 ]; then
        scene=$(realpath "$1")
        return
    fi
    need octbuild
    scene=$work/mirror_room.txt
    cp "$here/../../scenes/mirror_room.txt" "$scene"
    octbuild -q "$here/../../assets/bunny.obj" -o "$work/bunny.oct"
}

# A number of a statistics file.
number() {
    sed -n "s/^ *\"$2\": \([0-9.e+-]*\),*\$/\1/p" "$1" | head -n 1
}

# The picture by one process on all slots.
reference() {
    begin=$(now)
    octrender "$scene" -q -o "$work/one.png" --threads "$slots" --stats "$work/one.json" "$@"
    octrender "$scene" -q -o "$work/one.exr" --threads "$slots" "$@" >/dev/null
    one_wall=$(number "$work/one.json" seconds)
    one_cpu=$(number "$work/one.json" trace_cpu_seconds)
    echo "one process, $slots threads: $one_wall s, $one_cpu s of processors"
}

# Puts the parts together and compares; $1 is the wall time of all shares.
compare() {
    for suffix in png exr; do
        octrender --assemble "$work"/parts/*-of-"$shares".exr -q -o "$work/many.$suffix"
        cmp "$work/one.$suffix" "$work/many.$suffix" || die "the pictures differ ($suffix)"
    done
    echo "assembled picture: the same bytes as that of one process (PNG and EXR)"
    for file in "$work"/parts/share-*.json; do
        echo "$(number "$file" trace_cpu_seconds) $(number "$file" bytes_read) $(number "$file" seconds)"
    done | awk -v wall="$1" -v one_wall="$one_wall" -v one_cpu="$one_cpu" -v slots="$slots" '
        { cpu += $1; read += $2; if ($1 > most) most = $1; n += 1 }
        END {
            printf "%d shares on %d slots: %.2f s from the first to the last, %.2f s of processors\n", n, slots, wall, cpu
            printf "  tracing, by processor time: %.1f %% of what one process takes for the same\n", 100 * cpu / one_cpu
            printf "  dearest share against the mean: %.3f\n", most * n / cpu
            printf "  efficiency by wall time, waiting and the killed share included: %.1f %%\n", 100 * one_wall / wall
            printf "  bytes read by all shares: %.1f MiB\n", read / 1048576
        }'
    echo "  bytes read by one process: $(number "$work/one.json" bytes_read | awk '{ printf "%.1f MiB", $1 / 1048576 }')"
}
