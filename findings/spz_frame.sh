#!/usr/bin/env bash
# Converters write the numbers of a .ply into a .spz as they are.
#
# README.md of github.com/nianticlabs/spz (commit 21715c3): "By default, SPZ stores data in an RUB
# coordinate system ... This differs from other data formats such as PLY (which typically uses
# RDF)." A conversion from RDF to RUB would change the signs of y and z. Its own ply_to_spz and the
# programs below change none: a .spz of a .ply has the axes of the .ply, unless the caller names a
# frame. None of the four writes the record SPZ_ADOBE_coordinate_system, which could say so.
#
# Seen: spz-js 1.2.5 (version 2), @playcanvas/splat-transform 3.7.0 (versions 3 and 4),
# @adobe/spz 0.2.3 with its default frame, UNSPECIFIED (version 4), and gsply 0.4.6 (versions 3 and
# 4) store the center (1, 2, 3) as (1, 2, 3).
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip --disable-pip-version-check install -q -q gsply==0.4.6 zstandard==0.25.0
npm init -y >/dev/null
npm install --silent --no-audit --no-fund spz-js@1.2.5 @playcanvas/splat-transform@3.7.0 @adobe/spz@0.2.3

env/bin/python - <<'PY'
import struct

names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"]
names += [f"scale_{i}" for i in range(3)] + [f"rot_{i}" for i in range(4)]
rows = [[1, 2, 3, 0.1, 0.2, 0.3, 1, -3, -4, -5, 1, 0, 0, 0], [0] * 10 + [1, 0, 0, 0]]
lines = ["ply", "format binary_little_endian 1.0", "element vertex 2"]
lines += [f"property float {name}" for name in names] + ["end_header", ""]
data = b"".join(struct.pack("<14f", *row) for row in rows)
open("a.ply", "wb").write("\n".join(lines).encode() + data)

import gsply
from gsply.spz import write_spz

for version in (3, 4):
    write_spz(f"gsply-0.4.6-{version}.spz", gsply.plyread("a.ply"), version=version)
PY

cat > convert.mjs <<'JS'
import fs from "fs";
import { Readable } from "stream";
import { loadPly, serializeSpz } from "spz-js";
import createSpzModule from "@adobe/spz";

const cloud = await loadPly(Readable.toWeb(fs.createReadStream("a.ply")));
fs.writeFileSync("spz-js-1.2.5.spz", Buffer.from(await serializeSpz(cloud)));

const spz = await createSpzModule({ print: () => {}, printErr: () => {} });
const copy = { ...cloud, extensions: [] };
for (const key of ["positions", "scales", "rotations", "alphas", "colors", "sh"]) {
  copy[key] = Float32Array.from(cloud[key]);
}
const options = { version: 4, from: spz.CoordinateSystem.UNSPECIFIED, sh1Bits: 5, shRestBits: 4 };
fs.writeFileSync("adobe-spz-0.2.3.spz", Buffer.from(spz.saveSpzToBuffer(copy, options)));
JS
node convert.mjs
for version in 3 4; do
  npx splat-transform -q -w --spz-version "$version" a.ply "splat-transform-3.7.0-$version.spz"
done

env/bin/python - <<'PY'
import gzip
import pathlib
import struct
import sys

import zstandard

paths = sorted(pathlib.Path(".").glob("*.spz"))
centers = set()
for path in paths:
    data = path.read_bytes()
    if data[:2] == b"\x1f\x8b":
        data = gzip.decompress(data)
        version, bits, flags = data[4], data[13], data[14]
        positions = data[16:34]
    else:
        version, bits, flags = data[4], data[13], data[14]
        table = struct.unpack_from("<I", data, 16)[0]
        start, packed = table + 16 * data[15], struct.unpack_from("<Q", data, table)[0]
        positions = zstandard.ZstdDecompressor().decompress(data[start : start + packed])
    fixed = [int.from_bytes(positions[i : i + 3], "little", signed=True) for i in range(0, 18, 3)]
    rows = {tuple(v / 2**bits for v in fixed[i : i + 3]) for i in (0, 3)}
    center = max(rows, key=lambda row: sum(map(abs, row)))
    extensions = "extension records" if flags & 2 else "no extension records"
    print(f"{path}: version {version}, center {center}, {extensions}")
    centers.add((center, flags & 2))
if len(paths) != 6 or centers != {((1.0, 2.0, 3.0), 0)}:
    sys.exit("this has changed: expected six files with the center (1, 2, 3) and no records")
print("as in the .ply: nothing is turned from RDF to RUB")
PY
