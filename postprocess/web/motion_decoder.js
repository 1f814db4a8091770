// Decoder of moving Gaussians; docs/reference/web-format.md describes the bytes.
"use strict";

const SEGMENT = 1024; // rows that share a predictor
const MAGIC = "VGMPIWEB";
const SHAPE_CHANNELS = { fixed: 0, size: 1, deformation: 10 };

// Code points of the bytes 0x80 to 0x9f in windows-1252, the encoding of the page.
const HIGH = new Map(
  [0x20ac, 0x81, 0x201a, 0x192, 0x201e, 0x2026, 0x2020, 0x2021, 0x2c6, 0x2030, 0x160, 0x2039, 0x152,
   0x8d, 0x17d, 0x8f, 0x90, 0x2018, 0x2019, 0x201c, 0x201d, 0x2022, 0x2013, 0x2014, 0x2dc, 0x2122,
   0x161, 0x203a, 0x153, 0x9d, 0x17e, 0x178].map((code, k) => [code, 0x80 + k]));

// Return the bytes of an escaped array: "=" and the byte plus 64 stand for 0, "\r", "<" and "=".
function unescaped(codes) {
  const out = new Uint8Array(codes.length);
  let m = 0;
  for (let i = 0; i < codes.length; i++) out[m++] = codes[i] === 61 ? codes[++i] - 64 : codes[i];
  return out.slice(0, m);
}

// Return the bytes behind the page's text; a server that sent it as UTF-8 is asked again.
async function payload() {
  const text = document.getElementById("gaussians").textContent;
  const codes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) {
    let code = text.charCodeAt(i);
    if (code > 255) {
      code = HIGH.get(code);
      if (code === undefined) return fetched();
    }
    codes[i] = code;
  }
  return unescaped(codes);
}

// Return the same bytes out of the page's file.
async function fetched() {
  const page = new Uint8Array(await (await fetch(location.href)).arrayBuffer());
  const find = (words, from) => {
    const bytes = new TextEncoder().encode(words);
    for (let i = from; i < page.length; i++) {
      let k = 0;
      while (k < bytes.length && page[i + k] === bytes[k]) k++;
      if (k === bytes.length) return i;
    }
    throw new Error("the page holds no Gaussians");
  };
  const opening = 'id="gaussians" type="application/octet-stream">';
  const start = find(opening, 0) + opening.length;
  return unescaped(page.subarray(start, find("</" + "script>", start)));
}

// Inflate bytes; chunks read one by one take two thirds of the time of a Response.
async function inflate(bytes) {
  const stream = new DecompressionStream("deflate-raw"), writer = stream.writable.getWriter();
  const written = writer.write(bytes).then(() => writer.close());
  const reader = stream.readable.getReader(), chunks = [];
  let length = 0;
  for (let part = await reader.read(); !part.done; part = await reader.read()) {
    chunks.push(part.value);
    length += part.value.length;
  }
  await written;
  const out = new Uint8Array(length);
  let position = 0;
  for (const chunk of chunks) {
    out.set(chunk, position);
    position += chunk.length;
  }
  return out;
}

function halfToFloat(h) {
  const sign = h & 0x8000 ? -1 : 1, exponent = (h >> 10) & 31, fraction = h & 1023;
  if (exponent === 0) return sign * fraction * 2 ** -24;
  return sign * (1 + fraction / 1024) * 2 ** (exponent - 15);
}

// Integers (channels, rows) that are coded by their changes.
class CodedRows {
  constructor(rows, channels) {
    this.rows = rows;
    this.channels = channels;
    this.buffers = Array.from({ length: 4 }, () => new Int32Array(rows * channels));
    this.history = [this.buffers[0], this.buffers[0], this.buffers[0]];
  }

  // Decode the next frame; return the position behind it. The values are in history[0].
  decode(block, position, isKey) {
    const out = this.buffers.find((buffer) => !this.history.includes(buffer));
    for (let c = 0; c < this.channels; c++)
      position = this.decodeChannel(block, position, isKey, c * this.rows, out);
    this.history = isKey ? [out, out, out] : [out, this.history[0], this.history[1]];
    return position;
  }

  decodeChannel(block, position, isKey, base, out) {
    const n = this.rows, segments = Math.ceil(n / SEGMENT), modes = position;
    const planes = block[position + segments];
    position += segments + 1;
    if (planes === 0) out.fill(0, base, base + n);
    if (planes === 1)
      for (let i = 0; i < n; i++) {
        const u = block[position + i];
        out[base + i] = (u >>> 1) ^ -(u & 1);
      }
    if (planes === 2)
      for (let i = 0; i < n; i++) {
        const u = block[position + i] | (block[position + n + i] << 8);
        out[base + i] = (u >>> 1) ^ -(u & 1);
      }
    if (planes > 2)
      for (let i = 0; i < n; i++) {
        let u = 0;
        for (let k = 0; k < planes; k++) u |= block[position + k * n + i] << (8 * k);
        out[base + i] = (u >>> 1) ^ -(u & 1);
      }
    for (let s = 0; s < segments; s++) {
      const start = base + s * SEGMENT, stop = base + Math.min((s + 1) * SEGMENT, n);
      const mode = block[modes + s];
      this.addRowsBefore(mode >> 2, out, start, stop);
      if (!isKey) this.addFramesBefore(mode & 3, out, start, stop);
    }
    return position + planes * n;
  }

  addRowsBefore(window, out, start, stop) {
    let a = 0, b = 0, c = 0, d = 0;
    if (window === 1) for (let i = start; i < stop; i++) out[i] = a = out[i] + a;
    if (window === 2)
      for (let i = start; i < stop; i++) {
        const value = out[i] + ((a + b + c + d) >> 2);
        d = c; c = b; b = a; a = value;
        out[i] = value;
      }
  }

  addFramesBefore(predictor, out, start, stop) {
    const [p, q, r] = this.history;
    if (predictor === 0) for (let i = start; i < stop; i++) out[i] += p[i];
    if (predictor === 1) for (let i = start; i < stop; i++) out[i] += 2 * p[i] - q[i];
    if (predictor === 2)
      for (let i = start; i < stop; i++) out[i] += (7 * p[i] - 2 * q[i] - r[i]) >> 2;
    if (predictor === 3) for (let i = start; i < stop; i++) out[i] += 3 * (p[i] - q[i]) + r[i];
  }
}

// Rest Gaussians and frames of a payload.
class Motion {
  constructor(bytes) {
    const magic = new TextDecoder().decode(bytes.subarray(0, 8));
    if (magic !== MAGIC) throw new Error("the page holds no moving Gaussians");
    const length = new DataView(bytes.buffer, bytes.byteOffset).getUint32(8, true);
    this.header = JSON.parse(new TextDecoder().decode(bytes.subarray(12, 12 + length)));
    this.blocks = bytes.subarray(12 + length);
    this.count = this.header.count;
    this.frames = this.header.frames;
    this.last = -1;
    let first = 0;
    this.groups = this.header.groups.map((group) => {
      const channels = 3 + SHAPE_CHANNELS[group.shape] + (group.color ? 3 : 0);
      const entry = { ...group, first, channels: group.motion === "free" ? channels : 0 };
      first += group.count;
      if (group.motion === "free") entry.coder = new CodedRows(group.count, channels);
      return entry;
    });
  }

  block(entry) {
    return inflate(this.blocks.subarray(entry.offset, entry.offset + entry.bytes));
  }

  // Read the rest Gaussians and fill the arrays that a viewer draws.
  async load() {
    const n = this.count, terms = this.header.sh_coefficients, block = await this.block(this.header.rest);
    let position = 0;
    const column = (bytes, decode) => {
      const low = position, high = position + n;
      position += bytes * n;
      return (i) => decode(bytes === 2 ? block[low + i] | (block[high + i] << 8) : block[low + i]);
    };
    this.centers = new Float32Array(4 * n); // x, y, z, factor on the size
    this.shapes = new Float32Array(12 * n); // quaternion w, x, y, z; stretch xx, xy, xz, yy; yz, zz
    this.roots = new Float32Array(8 * n); // square root of the covariance; unused; compensated lowpass
    this.colors = new Float32Array(4 * n); // color without view dependence, opacity
    this.harmonics = new Float32Array(4 * n * (terms - 1));
    this.present = new Uint8Array(n).fill(1);
    const fill = (array, stride, offset, get) => {
      for (let i = 0; i < n; i++) array[i * stride + offset] = get(i);
    };
    for (let k = 0; k < 6; k++)
      fill(this.roots, 8, k, column(2, (h) => halfToFloat(h) * this.header.cell));
    fill(this.colors, 4, 3, column(2, (u) => u / 65535));
    for (let k = 0; k < 3; k++)
      fill(this.colors, 4, k, column(2, (h) => 0.5 + 0.28209479177387814 * halfToFloat(h)));
    for (const group of this.groups) // the last of the unused numbers: lowpass of its training
      for (let i = group.first; i < group.first + group.count; i++)
        this.roots[8 * i + 7] = group.compensated_lowpass || 0;
    const step = this.header.sh_step;
    for (let k = 0; k < 3 * (terms - 1); k++) {
      const offset = 4 * Math.floor(k / 3) + (k % 3);
      fill(this.harmonics, 4 * (terms - 1), offset, column(1, (b) => ((b << 24) >> 24) * step));
    }
    for (let i = 0; i < n; i++) {
      this.centers[4 * i + 3] = 1;
      this.shapes.set([1, 0, 0, 0, 1, 0, 0, 1, 0, 1], 12 * i);
    }
    for (const group of this.groups) {
      if (group.motion === "free") continue;
      const coder = new CodedRows(group.count, 3);
      position = coder.decode(block, position, true);
      this.place(group, coder.history[0]);
      if (group.motion === "posed")
        group.rest = this.centers.slice(4 * group.first, 4 * (group.first + group.count));
    }
  }

  // Decode frame `index`; the arrays hold it afterwards.
  async seek(index) {
    let first = index;
    while (!this.frames[first].key) first--;
    if (first <= this.last && this.last <= index) first = this.last + 1;
    const blocks = [];
    for (let k = first; k <= index; k++) blocks.push(this.block(this.frames[k]));
    for (let k = first; k <= index; k++) {
      const block = await blocks[k - first];
      let position = 0;
      for (const group of this.groups) {
        if (group.motion !== "free") continue;
        group.mask = null;
        if (block[position++]) {
          group.mask = block.subarray(position, position + Math.ceil(group.count / 8));
          position += group.mask.length;
        }
        position = group.coder.decode(block, position, this.frames[k].key);
      }
      this.last = k;
    }
    for (const group of this.groups) {
      if (group.motion === "free") this.update(group);
      if (group.motion === "posed") this.pose(group, this.frames[index].poses[group.pose]);
    }
  }

  place(group, bins) {
    const [x, y, z] = this.header.origin, step = this.header.steps.position, n = group.count;
    for (let i = 0, k = 4 * group.first; i < n; i++, k += 4) {
      this.centers[k] = x + step * bins[i];
      this.centers[k + 1] = y + step * bins[n + i];
      this.centers[k + 2] = z + step * bins[2 * n + i];
    }
  }

  update(group) {
    const bins = group.coder.history[0], n = group.count, steps = this.header.steps;
    this.place(group, bins);
    if (group.shape === "size")
      for (let i = 0; i < n; i++)
        this.centers[4 * (group.first + i) + 3] = 1 + bins[3 * n + i] * steps.size;
    if (group.shape === "deformation")
      for (let c = 0; c < 10; c++) {
        const step = c < 4 ? steps.rotation : steps.stretch;
        const rest = c === 4 || c === 7 || c === 9 ? 1 : 0;
        for (let i = 0, k = 12 * group.first + c; i < n; i++, k += 12)
          this.shapes[k] = rest + step * bins[(3 + c) * n + i];
      }
    if (group.color)
      for (let c = 0; c < 3; c++)
        for (let i = 0; i < n; i++)
          this.colors[4 * (group.first + i) + c] =
            bins[(group.channels - 3 + c) * n + i] * steps.color;
    for (let i = 0; i < n; i++)
      this.present[group.first + i] = group.mask ? (group.mask[i >> 3] >> (i & 7)) & 1 : 1;
  }

  // Move a group by a rigid pose: three rows of a rotation and a shift.
  pose(group, p) {
    const rest = group.rest;
    const trace = p[0] + p[5] + p[10];
    let q = [1 + trace, p[9] - p[6], p[2] - p[8], p[4] - p[1]];
    if (trace < 0) {
      const candidates = [
        [p[9] - p[6], 1 + p[0] - p[5] - p[10], p[1] + p[4], p[2] + p[8]],
        [p[2] - p[8], p[1] + p[4], 1 - p[0] + p[5] - p[10], p[6] + p[9]],
        [p[4] - p[1], p[2] + p[8], p[6] + p[9], 1 - p[0] - p[5] + p[10]],
      ];
      const diagonal = [p[0], p[5], p[10]];
      q = candidates[diagonal.indexOf(Math.max(...diagonal))];
    }
    for (let i = 0; i < group.count; i++) {
      const [x, y, z] = rest.subarray(4 * i, 4 * i + 3), k = 4 * (group.first + i);
      for (let row = 0; row < 3; row++)
        this.centers[k + row] =
          p[4 * row] * x + p[4 * row + 1] * y + p[4 * row + 2] * z + p[4 * row + 3];
      this.shapes.set(q, 12 * (group.first + i));
    }
  }
}
