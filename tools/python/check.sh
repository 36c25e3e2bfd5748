#!/bin/sh
# Builds the wheel, installs it into a clean virtual environment, and tests it there: tools/python/check.sh [PYTEST ARGUMENTS]
set -eu
here=$(cd "$(dirname "$0")" && pwd)
venv=$(mktemp -d)
trap 'rm -rf "$venv"' EXIT
python3 -m venv "$venv"
"$venv/bin/pip" --quiet --disable-pip-version-check install 'maturin>=1.9,<2' pytest numpy trimesh embreex
rm -rf "$here/target/wheels"
"$venv/bin/maturin" build --release --manifest-path "$here/Cargo.toml" --out "$here/target/wheels" --interpreter "$venv/bin/python"
"$venv/bin/pip" --quiet --disable-pip-version-check install "$here"/target/wheels/octrace-*.whl
cd "$venv"
"$venv/bin/python" -m pytest -q "$@" "$here/tests"
