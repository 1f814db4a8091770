#!/usr/bin/env bash
# Installs the programs of splat_converters.py, pinned, into FOLDER; tests that compare Gaussian
# files with other programs need it: VGMPI_SPLAT_TOOLS=FOLDER python -m pytest tests/gaussians
set -euo pipefail
folder=${1:?usage: install_splat_tools.sh FOLDER [PYTHON]}
python=${2:-python3} # its packages gsply, usd-core and numpy are used as well
mkdir -p "$folder"
cd "$folder"
rm -f complete
[ -f package.json ] || npm init -y >/dev/null
npm install --silent --no-audit --no-fund @playcanvas/splat-transform@3.7.0 @adobe/spz@0.2.3 \
    spz-js@1.2.5 @mkkellogg/gaussian-splats-3d@0.4.7 three@0.187.0 gltf-validator@2.0.0-dev.3.10
"$python" -m pip --disable-pip-version-check install -q -q --no-deps --upgrade --target python \
    gaussforge==0.6.0 gsplat2usd==0.1.5
touch complete # the tests look for it
