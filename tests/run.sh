#!/bin/bash
# bash tests/run.sh [PYTEST ARGUMENT ...]: installs what is missing, then runs the tests.
set -euo pipefail
cd "$(dirname "$(realpath "$0")")/.."

. demos/install.sh
exec .venv/bin/python -m pytest "$@"
