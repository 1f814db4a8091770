// Viewer of moving Gaussians in WebGL2: the projection and blending of vgmpi's rasterizer.
"use strict";

const WIDTH = 2048; // texels of a row of the data textures

const VERTEX = `#version 300 es
precision highp float; precision highp int; precision highp sampler2D;
uniform sampler2D centers, shapes, roots, colors, harmonics;
uniform mat3 turn; uniform vec3 shift, eye; uniform vec2 focal, size;
uniform float near, alphaMin, lowpass; uniform int terms; uniform bool antialias;
in uint index;
out vec2 offset; flat out vec3 conic; flat out vec4 look;
vec4 texel(sampler2D s, int t) { return texelFetch(s, ivec2(t % ${WIDTH}, t / ${WIDTH}), 0); }
mat3 symmetric(vec4 a, vec2 b) { return mat3(a.x, a.y, a.z, a.y, a.w, b.x, a.z, b.x, b.y); }
mat3 rotation(vec4 q) {
  float l = dot(q, q);
  q = l > 0.0 ? q * inversesqrt(l) : vec4(1.0, 0.0, 0.0, 0.0);
  float w = q.x, x = q.y, y = q.z, z = q.w;
  return mat3(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
              2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
              2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}
vec3 shiny(int i, vec3 d) {
  int t = i * (terms - 1);
  float x = d.x, y = d.y, z = d.z, xx = x * x, yy = y * y, zz = z * z;
  vec3 c = 0.4886025119029199 * (-y * texel(harmonics, t).rgb + z * texel(harmonics, t + 1).rgb
    - x * texel(harmonics, t + 2).rgb);
  if (terms > 4) c += 1.0925484305920792 * (x * y * texel(harmonics, t + 3).rgb
    - y * z * texel(harmonics, t + 4).rgb - x * z * texel(harmonics, t + 6).rgb)
    + 0.31539156525252005 * (2.0 * zz - xx - yy) * texel(harmonics, t + 5).rgb
    + 0.5462742152960396 * (xx - yy) * texel(harmonics, t + 7).rgb;
  if (terms > 9) c += -0.5900435899266435 * (y * (3.0 * xx - yy) * texel(harmonics, t + 8).rgb
    + x * (xx - 3.0 * yy) * texel(harmonics, t + 14).rgb)
    + 2.890611442640554 * x * y * z * texel(harmonics, t + 9).rgb
    + 1.445305721320277 * z * (xx - yy) * texel(harmonics, t + 13).rgb
    - 0.4570457994644658 * (4.0 * zz - xx - yy) * (y * texel(harmonics, t + 10).rgb
    + x * texel(harmonics, t + 12).rgb)
    + 0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy) * texel(harmonics, t + 11).rgb;
  return c;
}
void main() {
  int i = int(index);
  vec4 center = texel(centers, i), color = texel(colors, i);
  vec3 p = turn * center.xyz + shift;
  gl_Position = vec4(0.0, 0.0, 2.0, 1.0);
  if (!(p.z >= near) || color.a < alphaMin) return;
  vec4 quat = texel(shapes, 3 * i), a = texel(shapes, 3 * i + 1), b = texel(shapes, 3 * i + 2);
  vec4 r = texel(roots, 2 * i), s = texel(roots, 2 * i + 1);
  mat3 R = rotation(quat);
  mat3 M = turn * R * symmetric(a, b.xy) * symmetric(r, s.xy) * center.w;
  vec2 limit = 0.65 * size / focal, uv = p.xy / p.z, m = focal / p.z;
  vec2 c = clamp(uv, -limit, limit);
  vec3 T0 = m.x * (vec3(1.0, 0.0, -c.x) * M), T1 = m.y * (vec3(0.0, 1.0, -c.y) * M);
  float xx = dot(T0, T0), xy = dot(T0, T1), yy = dot(T1, T1);
  float opacity = color.a, det0 = xx * yy - xy * xy;
  bool own = !antialias && s.w > 0.0; // trained with a lowpass of its own, compensated
  float variance = own ? s.w : lowpass;
  xx += variance; yy += variance;
  float det = xx * yy - xy * xy;
  if (antialias || own) opacity *= sqrt(max(det0 / det, 0.0));
  if (opacity < alphaMin) return;
  vec3 rgb = color.rgb;
  if (terms > 1) rgb += shiny(i, normalize(transpose(R) * (center.xyz - eye)));
  look = vec4(max(rgb, 0.0), opacity);
  conic = vec3(yy, -xy, xx) / det;
  float reach = sqrt(2.0 * log(opacity / alphaMin));
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
  offset = corner * (reach * sqrt(vec2(xx, yy)) + 1.0);
  vec2 pixel = focal * uv + offset;
  gl_Position = vec4(2.0 * pixel.x / size.x, -2.0 * pixel.y / size.y, 0.0, 1.0);
}`;

const FRAGMENT = `#version 300 es
precision highp float;
uniform float alphaMin;
in vec2 offset; flat in vec3 conic; flat in vec4 look;
out vec4 pixel;
void main() {
  vec2 d = offset;
  float s = 0.5 * (conic.x * d.x * d.x + conic.z * d.y * d.y) + conic.y * d.x * d.y;
  float alpha = min(0.99, look.a * exp(-s));
  if (alpha < alphaMin) discard;
  pixel = vec4(look.rgb * alpha, alpha);
}`;

const SCREEN_VERTEX = `#version 300 es
void main() {
  gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0);
}`;

const SCREEN_FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D sum; uniform vec3 background;
out vec4 pixel;
void main() {
  vec4 c = texelFetch(sum, ivec2(gl_FragCoord.xy), 0);
  pixel = vec4(c.rgb + (1.0 - c.a) * background, 1.0);
}`;

function program(gl, vertex, fragment) {
  const p = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(p, shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost())
      throw new Error(gl.getShaderInfoLog(shader));
  }
  gl.linkProgram(p);
  if (!gl.getProgramParameter(p, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(p));
  const uniforms = {};
  for (let k = 0; k < gl.getProgramParameter(p, gl.ACTIVE_UNIFORMS); k++) {
    const name = gl.getActiveUniform(p, k).name;
    uniforms[name] = gl.getUniformLocation(p, name);
  }
  return { p, uniforms };
}

// Float texture of consecutive texels.
class DataTexture {
  constructor(gl, format, array) {
    this.gl = gl;
    this.rows = Math.max(1, Math.ceil(array.length / 4 / WIDTH));
    if (this.rows > gl.getParameter(gl.MAX_TEXTURE_SIZE))
      throw new Error("these Gaussians do not fit into a texture of this graphics card");
    this.padded = new Float32Array(4 * WIDTH * this.rows);
    this.texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
    gl.texStorage2D(gl.TEXTURE_2D, 1, format, WIDTH, this.rows);
    for (const side of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER])
      gl.texParameteri(gl.TEXTURE_2D, side, gl.NEAREST);
    this.upload(array);
  }

  upload(array) {
    const gl = this.gl;
    this.padded.set(array);
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, WIDTH, this.rows, gl.RGBA, gl.FLOAT, this.padded);
  }
}

class Renderer {
  constructor(canvas, motion) {
    const gl = canvas.getContext("webgl2", { antialias: false, preserveDrawingBuffer: true });
    if (!gl) throw new Error("this browser shows no WebGL2");
    this.gl = gl;
    this.motion = motion;
    this.isFloat = gl.getExtension("EXT_color_buffer_float") || gl.getExtension("EXT_color_buffer_half_float");
    this.splats = program(gl, VERTEX, FRAGMENT);
    this.screen = program(gl, SCREEN_VERTEX, SCREEN_FRAGMENT);
    const f = gl.RGBA32F, h = gl.RGBA16F;
    this.textures = {
      centers: new DataTexture(gl, f, motion.centers),
      shapes: new DataTexture(gl, f, motion.shapes),
      roots: new DataTexture(gl, f, motion.roots),
      colors: new DataTexture(gl, f, motion.colors),
      harmonics: new DataTexture(gl, h, motion.harmonics),
    };
    const moves = (test) => motion.groups.some(test);
    this.changing = ["centers"];
    if (moves((g) => g.shape === "deformation" || g.motion === "posed")) this.changing.push("shapes");
    if (moves((g) => g.color)) this.changing.push("colors");
    this.order = new Uint32Array(motion.count);
    this.depth = new Float32Array(motion.count);
    this.buffer = gl.createBuffer();
    this.array = gl.createVertexArray();
    gl.bindVertexArray(this.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, this.order.byteLength, gl.DYNAMIC_DRAW);
    const place = gl.getAttribLocation(this.splats.p, "index");
    gl.enableVertexAttribArray(place);
    gl.vertexAttribIPointer(place, 1, gl.UNSIGNED_INT, 0, 0);
    gl.vertexAttribDivisor(place, 1);
    this.target = gl.createFramebuffer();
  }

  // Send the arrays of the current frame to the graphics card.
  update() {
    for (const name of this.changing) this.textures[name].upload(this.motion[name]);
  }

  resize(width, height) {
    const gl = this.gl;
    if (this.width === width && this.height === height) return;
    [this.width, this.height] = [gl.canvas.width, gl.canvas.height] = [width, height];
    gl.deleteTexture(this.sum);
    this.sum = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.sum);
    gl.texStorage2D(gl.TEXTURE_2D, 1, this.isFloat ? gl.RGBA16F : gl.RGBA8, width, height);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.sum, 0);
  }

  // Sort the Gaussians in front of the camera from far to near; return their number.
  sort(turn, shift) {
    const { centers, present, count } = this.motion, depth = this.depth, order = this.order;
    const [a, b, c] = turn[2], d = shift[2];
    let low = Infinity, high = -Infinity;
    for (let i = 0, k = 0; i < count; i++, k += 4) {
      const z = a * centers[k] + b * centers[k + 1] + c * centers[k + 2] + d;
      depth[i] = present[i] ? z : -1;
      if (z > 0 && present[i]) {
        if (z < low) low = z;
        if (z > high) high = z;
      }
    }
    const buckets = 1 << 16, scale = (buckets - 1) / Math.max(high - low, 1e-30);
    const starts = new Uint32Array(buckets + 1);
    for (let i = 0; i < count; i++)
      if (depth[i] > 0) starts[((high - depth[i]) * scale | 0) + 1]++;
    for (let k = 0; k < buckets; k++) starts[k + 1] += starts[k];
    const visible = starts[buckets];
    for (let i = 0; i < count; i++)
      if (depth[i] > 0) order[starts[(high - depth[i]) * scale | 0]++] = i;
    return visible;
  }

  draw(camera, view) {
    const gl = this.gl, { turn, shift } = camera.matrices(), u = this.splats.uniforms;
    const count = this.sort(turn, shift);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.viewport(0, 0, this.width, this.height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.useProgram(this.splats.p);
    gl.bindVertexArray(this.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    gl.bufferSubData(gl.ARRAY_BUFFER, 0, this.order.subarray(0, count));
    Object.entries(this.textures).forEach(([name, data], unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, data.texture);
      gl.uniform1i(u[name], unit);
    });
    const focal = 0.5 * this.height / Math.tan(0.5 * camera.fov * Math.PI / 180);
    gl.uniformMatrix3fv(u.turn, true, turn.flat());
    gl.uniform3fv(u.shift, shift);
    gl.uniform3fv(u.eye, camera.eye);
    gl.uniform2f(u.focal, focal, focal);
    gl.uniform2f(u.size, this.width, this.height);
    gl.uniform1f(u.near, camera.near());
    gl.uniform1f(u.alphaMin, view.alpha_min);
    gl.uniform1f(u.lowpass, view.lowpass);
    gl.uniform1i(u.antialias, view.antialias ? 1 : 0);
    gl.uniform1i(u.terms, this.motion.header.sh_coefficients);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, count);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.disable(gl.BLEND);
    gl.useProgram(this.screen.p);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.sum);
    gl.uniform1i(this.screen.uniforms.sum, 0);
    gl.uniform3fv(this.screen.uniforms.background, view.background);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
}

const add = (a, b, k = 1) => a.map((v, i) => v + k * b[i]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) =>
  [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => a.map((v) => v / Math.hypot(...a));

// Pinhole camera: x right, y down, z forward.
class Camera {
  constructor(view) {
    this.set(view);
  }

  set({ eye, target, up, fov }) {
    Object.assign(this, { eye: [...eye], target: [...target], up: unit(up), fov });
  }

  near() {
    return Math.min(0.2, 0.05 * Math.hypot(...add(this.target, this.eye, -1)));
  }

  matrices() {
    const forward = unit(add(this.target, this.eye, -1));
    const right = unit(cross(forward, this.up)), down = cross(forward, right);
    const turn = [right, down, forward];
    return { turn, shift: turn.map((row) => -dot(row, this.eye)) };
  }

  orbit(dx, dy) {
    const arm = add(this.eye, this.target, -1), length = Math.hypot(...arm);
    const { turn } = this.matrices();
    let pitch = Math.asin(dot(arm, this.up) / length) + dy;
    pitch = Math.max(-1.55, Math.min(1.55, pitch));
    const back = unit(cross(turn[0], this.up)); // level, away from the target
    const level = add(back.map((v) => v * Math.cos(dx)), turn[0], -Math.sin(dx));
    const arm2 = add(level.map((v) => v * Math.cos(pitch)), this.up, Math.sin(pitch));
    this.eye = add(this.target, arm2, length);
  }

  zoom(factor) {
    this.eye = add(this.target, add(this.eye, this.target, -1), factor);
  }

  pan(dx, dy, height) {
    const { turn } = this.matrices();
    const length = Math.hypot(...add(this.eye, this.target, -1));
    const scale = 2 * length * Math.tan(0.5 * this.fov * Math.PI / 180) / height;
    const move = add(turn[0].map((v) => -v * dx * scale), turn[1], -dy * scale);
    this.eye = add(this.eye, move);
    this.target = add(this.target, move);
  }
}
