#!/usr/bin/env bash
# splat-transform turns a .ply by half a turn about z when it writes a .glb, and not when it writes
# a .sog.
#
# glTF 2.0: +Y is up, the front faces +Z, the left side faces +X. A capture in a .ply has x right,
# y down, z forward, so that (x, y, z) becomes (-x, -y, z). The specification of SOG
# (developer.playcanvas.com, section 1.2) names x right, y up, z back; the numbers of the .ply are
# written unchanged nevertheless, as they are for .spz.
#
# Seen: @playcanvas/splat-transform 3.7.0 stores the center (1, 2, 3) of a .ply as (-1, -2, 3) in a
# .glb and as (1, 2, 3) in a .sog. It does not read the .glb that it wrote.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
npm init -y >/dev/null
npm install --silent --no-audit --no-fund @playcanvas/splat-transform@3.7.0

python3 - <<'PY'
import struct

names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"]
names += [f"scale_{i}" for i in range(3)] + [f"rot_{i}" for i in range(4)]
rows = [[1, 2, 3, 0.1, 0.2, 0.3, 1, -3, -4, -5, 1, 0, 0, 0], [0] * 10 + [1, 0, 0, 0]]
lines = ["ply", "format binary_little_endian 1.0", "element vertex 2"]
lines += [f"property float {name}" for name in names] + ["end_header", ""]
data = b"".join(struct.pack("<14f", *row) for row in rows)
open("a.ply", "wb").write("\n".join(lines).encode() + data)
PY

npx splat-transform -q -w a.ply a.glb
npx splat-transform -q -w -g cpu a.ply a.sog
reads_back=no
if npx splat-transform -q -w a.glb back.ply >/dev/null 2>&1; then reads_back=yes; fi

READS_BACK=$reads_back python3 - <<'PY'
import json
import math
import os
import struct
import sys
import zipfile

data = open("a.glb", "rb").read()
size = struct.unpack_from("<I", data, 12)[0]
header = json.loads(data[20 : 20 + size])
attributes = header["meshes"][0]["primitives"][0]["attributes"]
view = header["bufferViews"][header["accessors"][attributes["POSITION"]]["bufferView"]]
numbers = struct.unpack_from("<6f", data, 28 + size + view.get("byteOffset", 0))
glb = max(numbers[:3], numbers[3:], key=lambda x: sum(map(abs, x)))
means = json.loads(zipfile.ZipFile("a.sog").read("meta.json"))["means"]
ends = zip(means["mins"], means["maxs"])
logs = [max(pair, key=abs) for pair in ends]  # sign(x) log(1 + |x|); the other end is 0
sog = tuple(round(math.copysign(math.expm1(abs(v)), v), 5) for v in logs)
print("@playcanvas/splat-transform 3.7.0: center (1, 2, 3) of the .ply")
print(f"in the .glb: {glb}, which is read back: {os.environ['READS_BACK']}")
print(f"in the .sog: {sog}")
if glb != (-1, -2, 3) or sog != (1, 2, 3) or os.environ["READS_BACK"] != "no":
    sys.exit("this has changed: expected (-1, -2, 3), not read back, and (1, 2, 3)")
PY
