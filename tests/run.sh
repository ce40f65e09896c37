#!/bin/bash
# bash tests/run.sh [PYTEST ARGUMENT ...]: installs what is missing, then runs the tests.
set -euo pipefail
cd "$(dirname "$(realpath "$0")")/.."

. demos/install.sh
packages=(chromium) # for the live view's tests
install_packages
[ $# -eq 0 ] || exec .venv/bin/python -m pytest "$@"
# All of them, on all cores. Then those that draw: beside dolfinx, pictures are drawn in processes of their own.
.venv/bin/python -m pytest --numprocesses auto --maxprocesses 4 --dist loadfile --ignore tests/exports
exec .venv/bin/python -m pytest tests/exports
