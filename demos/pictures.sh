#!/bin/bash
# bash demos/pictures.sh: makes the pictures of the pages that are made on the command line.
set -euo pipefail
cd "$(dirname "$(realpath "$0")")/.."
. demos/install.sh

folder=$(mktemp -d)
trap 'rm -r "$folder"' EXIT
fenics_rom() {
  .venv/bin/python -m fenics_rom "$@"
}

fenics_rom reduce demos/finger/finger.toml --method balanced --order 40 -o "$folder/finger.h5"  # modes that have a σ
fenics_rom simulate "$folder/finger.h5" -o "$folder/run.h5"
fenics_rom export "$folder/finger.h5" -o demos/finger/modes.png --count 4
fenics_rom export "$folder/run.h5" -o demos/finger/closing.gif --seconds 2.4
