#!/bin/sh
# Builds the wheel, installs it into a clean virtual environment, and tests it there:
#   tools/python/check.sh [--quick | --keep FOLDER] [PYTEST ARGUMENTS]
# The wheel is then in tools/python/target/wheels. --quick compiles in a fraction of the time, without optimizations, and keeps that wheel elsewhere;
# --keep leaves the virtual environment in FOLDER.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
target=${CARGO_TARGET_DIR:-$here/target}
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
venv=$scratch/venv profile=release wheels=$target/wheels
case "${1:-}" in
--quick) profile=quick wheels=$scratch/wheels && shift ;;
--keep) venv=${2:?--keep needs a folder} && shift 2 ;;
esac
say() { echo "tools/python/check.sh: $*" >&2; }

# Without Python there is nothing to test here; octrace itself does not need it.
python=${PYTHON:-python3}
if ! command -v "$python" >/dev/null || ! "$python" -c 'import sys; sys.exit(sys.version_info < (3, 9))'; then
    say "skipped: there is no Python 3.9 or newer ($python)"
    exit 77
fi
if ! "$python" -m venv --clear "$venv" >/dev/null 2>&1; then
    say "skipped: $python has no venv (Debian: apt-get install python3-venv)"
    exit 77
fi
pip() { "$venv/bin/python" -m pip --quiet --disable-pip-version-check "$@"; }
if ! pip install 'maturin>=1.9,<2' pytest mypy numpy trimesh embreex; then
    say "skipped: pip cannot install maturin, pytest, mypy, numpy, trimesh and embreex (no network?)"
    exit 77
fi

rm -rf "$wheels"
"$venv/bin/maturin" build --locked --profile "$profile" --target-dir "$target" --manifest-path "$here/Cargo.toml" --out "$wheels" \
    --interpreter "$venv/bin/python"
pip install "$wheels"/octrace-*.whl
cd "$scratch"
"$venv/bin/python" -m pytest -q -p no:cacheprovider "$@" "$here/tests"
