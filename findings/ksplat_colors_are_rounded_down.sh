#!/usr/bin/env bash
# GaussianSplats3D rounds colors and opacities down to bytes when it makes a .ksplat of a .ply.
#
# A .ksplat is therefore darker and more transparent than its .ply by half a 255th on average, at
# every compression level. (Colors that would be 255ths exactly keep their value.)
#
# Seen: @mkkellogg/gaussian-splats-3d 0.4.7 stores the color 100.9 / 255 as 100 and the opacity
# 200.9 / 255 as 200.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
npm init -y >/dev/null
npm install --silent --no-audit --no-fund @mkkellogg/gaussian-splats-3d@0.4.7 three@0.180.0

python3 - <<'PY'
import math
import struct

names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"]
names += [f"scale_{i}" for i in range(3)] + [f"rot_{i}" for i in range(4)]
dc = (100.9 / 255 - 0.5) * 2 * math.sqrt(math.pi)
logit = math.log(200.9 / (255 - 200.9))
lines = ["ply", "format binary_little_endian 1.0", "element vertex 1"]
lines += [f"property float {name}" for name in names] + ["end_header", ""]
data = struct.pack("<14f", 1, 2, 3, dc, dc, dc, logit, -3, -4, -5, 1, 0, 0, 0)
open("a.ply", "wb").write("\n".join(lines).encode() + data)
PY

cat > convert.mjs <<'JS'
import * as fs from "fs";
import * as THREE from "three";
import { PlyParser, SplatBufferGenerator } from "@mkkellogg/gaussian-splats-3d";

const bytes = fs.readFileSync("a.ply");
const ply = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength);
for (const level of [0, 1, 2]) {
  const splats = PlyParser.parseToUncompressedSplatArray(ply, 0);
  const generator = SplatBufferGenerator.getStandardGenerator(1, level, 0, new THREE.Vector3());
  const made = generator.generateFromUncompressedSplatArray(splats);
  fs.writeFileSync(`${level}.ksplat`, Buffer.from(made.bufferData));
}
JS
node --no-deprecation convert.mjs >/dev/null

python3 - <<'PY'
import sys

seen = set()
for level in (0, 1, 2):
    data = open(f"{level}.ksplat", "rb").read()
    rgba = tuple(data[-4:])  # the last bytes of a row without higher colors
    print(f"@mkkellogg/gaussian-splats-3d 0.4.7, level {level}: 100.9, opacity 200.9 as {rgba}")
    seen.add(rgba)
if seen != {(100, 100, 100, 200)}:
    sys.exit("this has changed: expected 100, 100, 100, 200")
PY
