#!/bin/sh
# Run the tests on each of the supported Pythons found: the light install with the extra `test`, so
# without torch and the tests that import it.
#
#     sh tools/test-pythons.sh WORK ["3.12 3.13" [PYTEST-ARGUMENTS...]]
#
# WORK keeps an environment for each version. Pythons are looked for on the PATH, and among those of
# pyenv and uv. Exit code 1 if no version is found or a test fails.
set -eu
work=$1 versions=${2:-3.12 3.13}
[ $# -lt 2 ] || shift
shift

find_python() {
    for python in "$(command -v "python$1")" "${PYENV_ROOT:-$HOME/.pyenv}/versions/$1".*/bin/python \
        "$(uv python find --no-python-downloads "$1" 2>/dev/null)"; do
        # a shim of pyenv may be there without its Python
        "$python" --version >/dev/null 2>&1 && echo "$python" && return
    done
    return 1
}

found=
for version in $versions; do
    python=$(find_python "$version") || {
        echo "python$version: not found"
        continue
    }
    found="$found $version"
    venv=$work/$version
    [ -x "$venv/bin/python" ] || "$python" -m venv "$venv"
    "$venv/bin/python" -m pip install --quiet --constraint requirements.lock --editable '.[test]'
    echo "$("$venv/bin/python" --version): $("$venv/bin/python" -m pip list 2>/dev/null | wc -l) packages"
    "$venv/bin/python" -m pytest -n auto --dist loadfile --no-loadscope-reorder --max-worker-restart 0 "$@"
done
[ -n "$found" ] || { echo "none of Python $versions was found" >&2; exit 1; }
echo "passed on Python$found"
