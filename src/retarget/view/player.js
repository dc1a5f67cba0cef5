// The moving picture of a report: skins are moved on the graphics card from the joints of each frame. No library, no network.
"use strict";
(() => {
const page = JSON.parse(document.getElementById("scene").textContent);
const canvas = document.getElementById("stage");
const byId = (name) => document.getElementById(name);
const KINDS = {i1: Int8Array, u1: Uint8Array, i2: Int16Array, u2: Uint16Array, i4: Int32Array, u4: Uint32Array, f4: Float32Array};
const unpack = ({kind, data}) => {
  const text = atob(data), bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  return new KINDS[kind](bytes.buffer);
};
const last = page.frames - 1, seconds = last / page.fps;
const state = {
  time: 0, playing: page.frames > 1, speed: 1, yaw: page.yaw, pitch: 0.15, zoom: 1, pan: [0, 0, 0],
  layout: 0, follow: true, mesh: true, bones: false, sensors: false, spots: true, color: "clay",
  shown: page.bodies.map(() => true), lit: null, drawn: 0, dirty: true,
};

// --- the graphics card ------------------------------------------------------------------------------------------
const gl = canvas.getContext("webgl2", {alpha: false, antialias: true, stencil: true, preserveDrawingBuffer: true});
if (!gl) {
  byId("no-webgl").hidden = false;
  canvas.hidden = true;
}
const HEAD = "#version 300 es\nprecision highp float; precision highp int; precision highp sampler2D;\n";
const SKIN_VERTEX = HEAD + `
in vec3 place, normal, tint; in uvec4 boneA, boneB; in vec4 weightA, weightB; in float spot;
uniform sampler2D bones; uniform mat4 camera; uniform vec3 move, light; uniform bool shadow; uniform float dot_size, size;
out vec3 at, out_normal, color; out float touch, depth;
void main() {
  vec4 x = vec4(0), y = vec4(0), z = vec4(0);
  for (int k = 0; k < 8; k++) {
    int b = int(k < 4 ? boneA[k] : boneB[k - 4]);
    float w = k < 4 ? weightA[k] : weightB[k - 4];
    if (w == 0.0) break;  // strongest first
    x += w * texelFetch(bones, ivec2(0, b), 0); y += w * texelFetch(bones, ivec2(1, b), 0); z += w * texelFetch(bones, ivec2(2, b), 0);
  }
  vec4 p = vec4(place, 1), n = vec4(normal, 0);
  at = size * vec3(dot(x, p), dot(y, p), dot(z, p)) + move;
  out_normal = vec3(dot(x, n), dot(y, n), dot(z, n));
  if (shadow) at = vec3(at.xz - light.xz / light.y * max(at.y, 0.0), 0.0).xzy;
  color = tint; touch = min(spot, 1.0); depth = max(spot - 1.0, 0.0);
  gl_Position = camera * vec4(at, 1); gl_PointSize = dot_size;
}`;
const SKIN_FRAGMENT = HEAD + `
in vec3 at, out_normal, color; in float touch, depth;
uniform vec3 eye, light, flat_color; uniform bool shadow, flat_shaded; uniform float opacity, spots;
out vec4 shown;
vec3 linear(vec3 c) { return pow(c, vec3(2.2)); }
void main() {
  if (shadow) { shown = vec4(0.05, 0.06, 0.09, 0.18); return; }
  if (flat_shaded) {
    vec2 off = gl_PointCoord - 0.5;
    if (dot(off, off) > 0.25) discard;
    shown = vec4(dot(off, off) > 0.12 ? vec3(0.1) : flat_color, 1); return;
  }
  vec3 look = normalize(eye - at), n = normalize(out_normal);
  if (dot(n, look) < 0.0) n = -n;
  vec3 base = linear(color);
  float inside = smoothstep(0.2, 1.2, depth);
  vec3 heat = mix(linear(vec3(1.0, 0.66, 0.0)), linear(vec3(0.80, 0.05, 0.10)), clamp(depth / 30.0, 0.0, 1.0));
  base = mix(base, mix(linear(vec3(0.10, 0.52, 1.0)), heat, inside), spots * smoothstep(0.1, 0.5, touch));
  float key = pow(max((dot(n, light) + 0.25) / 1.25, 0.0), 1.5), sky = 0.5 + 0.5 * n.y;
  float rim = pow(1.0 - max(dot(n, look), 0.0), 3.0);
  vec3 lit = base * (vec3(0.24, 0.25, 0.27) + 0.22 * sky + 0.80 * key * vec3(1.03, 1.0, 0.95)) + 0.06 * rim;
  shown = vec4(pow(lit, vec3(1.0 / 2.2)), opacity);
}`;
const BONE_VERTEX = HEAD + `
in vec3 from, to; uniform mat4 camera; uniform vec2 size; uniform float width;
void main() {
  int k = gl_VertexID; float end = k == 1 || k == 3 || k == 4 ? 1.0 : 0.0, side = k == 2 || k == 4 || k == 5 ? 1.0 : -1.0;
  vec4 a = camera * vec4(from, 1), b = camera * vec4(to, 1), p = mix(a, b, end);
  vec2 way = (b.xy / b.w - a.xy / a.w) * size; way = length(way) > 1e-6 ? normalize(way) : vec2(1, 0);
  p.xy += vec2(-way.y, way.x) * side * width * mix(1.0, 0.45, end) / size * p.w; gl_Position = p;
}`;
const BONE_FRAGMENT = HEAD + `uniform vec4 tone; out vec4 shown; void main() { shown = tone; }`;
const GROUND_VERTEX = HEAD + `uniform mat4 camera; uniform vec3 middle; out vec2 at;
void main() { vec2 c = vec2(gl_VertexID % 2, gl_VertexID / 2) * 2.0 - 1.0; at = middle.xz + c * 14.0; gl_Position = camera * vec4(at.x, 0.0, at.y, 1); }`;
const GROUND_FRAGMENT = HEAD + `in vec2 at; uniform vec3 middle, back, floor_tone, line_tone; out vec4 shown;
float lines(float step) { vec2 p = at / step, w = max(fwidth(p), 1e-4), d = abs(fract(p - 0.5) - 0.5) / w; return (1.0 - min(min(d.x, d.y), 1.0)) * clamp(0.35 / max(w.x, w.y), 0.0, 1.0); }
void main() { float fade = 1.0 - smoothstep(2.0, 11.0, distance(at, middle.xz));
  vec3 floor_color = mix(back, floor_tone, fade); shown = vec4(mix(floor_color, line_tone, fade * (0.30 * lines(0.5) + 0.35 * lines(1.0))), 1); }`;
// sRGB of what is behind, of the floor and of its lines, by the reader's light or dark.
const TONES = {
  light: {back: [0.945, 0.95, 0.957], floor: [0.885, 0.89, 0.90], line: [0.62, 0.64, 0.68]},
  dark: {back: [0.118, 0.129, 0.145], floor: [0.165, 0.178, 0.20], line: [0.33, 0.35, 0.39]},
};
const night = matchMedia("(prefers-color-scheme: dark)");

const program = (vertex, fragment) => {
  const made = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text); gl.compileShader(shader); gl.attachShader(made, shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
  const uniforms = {};
  for (let i = 0; i < gl.getProgramParameter(made, gl.ACTIVE_UNIFORMS); i++) {
    const {name} = gl.getActiveUniform(made, i);
    uniforms[name] = gl.getUniformLocation(made, name);
  }
  return {made, uniforms, at: (name) => gl.getAttribLocation(made, name)};
};
const buffer = (values, target = gl.ARRAY_BUFFER, use = gl.STATIC_DRAW) => {
  const made = gl.createBuffer();
  gl.bindBuffer(target, made); gl.bufferData(target, values, use);
  return made;
};
const attribute = (where, of, size, kind, {normal = false, stride = 0, start = 0, whole = false} = {}) => {
  if (where < 0) return;
  gl.bindBuffer(gl.ARRAY_BUFFER, of); gl.enableVertexAttribArray(where);
  if (whole) gl.vertexAttribIPointer(where, size, kind, stride, start);
  else gl.vertexAttribPointer(where, size, kind, normal, stride, start);
};

let skins, lines, ground;
const mesh = (given) => {
  const array = gl.createVertexArray(), wide = given.columns.kind === "u2" ? 2 : 1;
  gl.bindVertexArray(array);
  const columns = buffer(unpack(given.columns)), weights = buffer(unpack(given.weights));
  const whole = {whole: true, stride: 8 * wide}, kind = wide === 2 ? gl.UNSIGNED_SHORT : gl.UNSIGNED_BYTE;
  attribute(skins.at("place"), buffer(unpack(given.vertices)), 3, gl.FLOAT);
  attribute(skins.at("boneA"), columns, 4, kind, whole);
  attribute(skins.at("boneB"), columns, 4, kind, {...whole, start: 4 * wide});
  attribute(skins.at("weightA"), weights, 4, gl.UNSIGNED_SHORT, {normal: true, stride: 16});
  attribute(skins.at("weightB"), weights, 4, gl.UNSIGNED_SHORT, {normal: true, stride: 16, start: 8});
  return {array, count: given.vertices.count};
};
const prepare = (given) => {
  const skin = mesh(given.skin), body = {given, skin};
  const faces = unpack(given.faces);
  body.faceKind = faces.BYTES_PER_ELEMENT === 4 ? gl.UNSIGNED_INT : gl.UNSIGNED_SHORT;
  body.corners = faces.length;
  buffer(faces, gl.ELEMENT_ARRAY_BUFFER);
  attribute(skins.at("normal"), buffer(unpack(given.normals)), 3, gl.BYTE, {normal: true, stride: 4});
  body.tints = {material: unpack(given.colors), parts: unpack(given.part_colors), clay: new Uint8Array(skin.count * 3)};
  for (let i = 0; i < skin.count * 3; i++) body.tints.clay[i] = given.clay[i % 3];
  body.tint = buffer(body.tints.clay, gl.ARRAY_BUFFER, gl.DYNAMIC_DRAW);
  attribute(skins.at("tint"), body.tint, 3, gl.UNSIGNED_BYTE, {normal: true});
  body.codes = new Uint8Array(skin.count);
  body.spot = buffer(body.codes, gl.ARRAY_BUFFER, gl.DYNAMIC_DRAW);
  attribute(skins.at("spot"), body.spot, 1, gl.UNSIGNED_BYTE);
  for (const name of ["starts", "spot_vertex", "spot_code", "rotations", "positions", "parents", "joints", "binds", "path"])
    body[name] = unpack(given[name]);
  body.sensors = given.sensors ? mesh(given.sensors) : null;
  body.jointCount = body.parents.length; body.columnCount = body.joints.length;
  body.rows = new Float32Array(body.columnCount * 12);
  body.world = new Float32Array(body.jointCount * 12);
  body.texture = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, body.texture);
  for (const side of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, side, gl.NEAREST);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, 3, body.columnCount, 0, gl.RGBA, gl.FLOAT, null);
  body.bones = Array.from(unpack(given.bones), (joint) => [body.parents[joint], joint]);
  body.ends = new Float32Array(Math.max(body.bones.length, 1) * 6);
  body.lineArray = gl.createVertexArray();
  gl.bindVertexArray(body.lineArray);
  body.lineBuffer = buffer(body.ends, gl.ARRAY_BUFFER, gl.DYNAMIC_DRAW);
  for (const [name, start] of [["from", 0], ["to", 12]]) {
    attribute(lines.at(name), body.lineBuffer, 3, gl.FLOAT, {stride: 24, start});
    gl.vertexAttribDivisor(lines.at(name), 1);
  }
  return body;
};
let bodies = [];
if (gl) {
  skins = program(SKIN_VERTEX, SKIN_FRAGMENT); lines = program(BONE_VERTEX, BONE_FRAGMENT); ground = program(GROUND_VERTEX, GROUND_FRAGMENT);
  bodies = page.bodies.map(prepare);
}

// --- a moment ---------------------------------------------------------------------------------------------------
const pose = (body, time) => {
  const place = Math.min(Math.max(time * page.fps, 0), last), frame = Math.min(Math.floor(place), Math.max(last - 1, 0));
  const part = place - frame, next = Math.min(frame + 1, last), J = body.jointCount, q = body.rotations, p = body.positions, world = body.world;
  for (let j = 0; j < J; j++) {
    const a = (frame * J + j) * 4, b = (next * J + j) * 4, c = (frame * J + j) * 3, d = (next * J + j) * 3;
    const same = q[a] * q[b] + q[a + 1] * q[b + 1] + q[a + 2] * q[b + 2] + q[a + 3] * q[b + 3] < 0 ? -part : part, stay = 1 - part;
    let x = q[a] * stay + q[b] * same, y = q[a + 1] * stay + q[b + 1] * same, z = q[a + 2] * stay + q[b + 2] * same, w = q[a + 3] * stay + q[b + 3] * same;
    const length = Math.hypot(x, y, z, w) || 1;
    x /= length; y /= length; z /= length; w /= length;
    world.set([
      1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w), p[c] * stay + p[d] * part,
      2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w), p[c + 1] * stay + p[d + 1] * part,
      2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y), p[c + 2] * stay + p[d + 2] * part], j * 12);
  }
  for (let k = 0; k < body.columnCount; k++) {
    const m = body.joints[k] * 12, n = k * 12, B = body.binds;
    for (let i = 0; i < 12; i += 4) for (let j = 0; j < 4; j++)
      body.rows[n + i + j] = world[m + i] * B[n + j] + world[m + i + 1] * B[n + 4 + j] + world[m + i + 2] * B[n + 8 + j] + (j === 3 ? world[m + i + 3] : 0);
  }
  gl.bindTexture(gl.TEXTURE_2D, body.texture);
  gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, 3, body.columnCount, gl.RGBA, gl.FLOAT, body.rows);
  const near = Math.round(place);
  if (near !== body.shownFrame) {
    body.shownFrame = near;
    body.codes.fill(0);
    for (let row = body.starts[near]; row < body.starts[near + 1]; row++) body.codes[body.spot_vertex[row]] = body.spot_code[row];
    gl.bindBuffer(gl.ARRAY_BUFFER, body.spot); gl.bufferSubData(gl.ARRAY_BUFFER, 0, body.codes);
  }
};
const along = (body, time) => {
  const place = Math.min(Math.max(time * page.fps, 0), last), frame = Math.floor(place), next = Math.min(frame + 1, last), part = place - frame;
  return [0, 1, 2].map((k) => body.path[frame * 3 + k] * (1 - part) + body.path[next * 3 + k] * part);
};

// --- the camera -------------------------------------------------------------------------------------------------
const FIELD = 0.5;
const product = (a, b) => { const c = new Float32Array(16); for (let i = 0; i < 4; i++) for (let j = 0; j < 4; j++) for (let k = 0; k < 4; k++) c[j * 4 + i] += a[k * 4 + i] * b[j * 4 + k]; return c; };
const sizeOf = (body) => state.layout > 1 ? body.given.size : 1;
const look = () => {
  const chosen = bodies.filter((_, i) => state.shown[i]), seen = chosen.length ? chosen : bodies;
  const moves = seen.map((body) => body.given.moves[state.layout]);
  const middle = [0, 1, 2].map((k) => moves.reduce((sum, move, i) => sum + move[k] + sizeOf(seen[i]) * along(seen[i], state.follow ? state.time : 0)[k], 0) / seen.length + state.pan[k]);
  const tall = Math.max(...seen.map((body) => sizeOf(body) * body.given.height));
  const wide = tall * 0.9 + Math.max(...moves.flatMap((a) => moves.map((b) => Math.hypot(a[0] - b[0], a[2] - b[2]))));
  const aspect = canvas.width / canvas.height, reach = Math.tan(FIELD / 2);
  const distance = state.zoom * Math.max(tall * 1.28 / 2 / reach, wide / 2 / reach / aspect);
  const [s, c, sp, cp] = [Math.sin(state.yaw), Math.cos(state.yaw), Math.sin(state.pitch), Math.cos(state.pitch)];
  const back = [s * cp, sp, c * cp], right = [c, 0, -s], up = [-s * sp, cp, -c * sp];
  const eye = middle.map((m, k) => m + back[k] * distance), dot = (a) => a[0] * eye[0] + a[1] * eye[1] + a[2] * eye[2];
  const view = [right[0], up[0], back[0], 0, right[1], up[1], back[1], 0, right[2], up[2], back[2], 0, -dot(right), -dot(up), -dot(back), 1];
  const near = distance * 0.02, far = distance + 60;
  const lens = [1 / reach / aspect, 0, 0, 0, 0, 1 / reach, 0, 0, 0, 0, (near + far) / (near - far), -1, 0, 0, 2 * near * far / (near - far), 0];
  const turn = state.yaw - 0.96, light = [Math.sin(turn) * 0.53, 0.848, Math.cos(turn) * 0.53];
  return {camera: product(lens, view), eye, middle, light, right, up, distance};
};

// --- drawing ----------------------------------------------------------------------------------------------------
const surface = (body, {camera, eye, light}, shadow, opacity) => {
  const u = skins.uniforms;
  gl.uniformMatrix4fv(u.camera, false, camera); gl.uniform3fv(u.eye, eye); gl.uniform3fv(u.light, light);
  gl.uniform3fv(u.move, body.given.moves[state.layout]); gl.uniform1f(u.size, sizeOf(body));
  gl.uniform1i(u.shadow, shadow); gl.uniform1i(u.flat_shaded, false); gl.uniform1f(u.opacity, opacity); gl.uniform1f(u.spots, state.spots ? 1 : 0);
  gl.bindTexture(gl.TEXTURE_2D, body.texture);
  gl.bindVertexArray(body.skin.array);
  gl.drawElements(gl.TRIANGLES, body.corners, body.faceKind, 0);
};
const skeleton = (body, index, {camera}) => {
  const move = body.given.moves[state.layout], world = body.world, size = sizeOf(body), at = (j, k) => size * world[j * 12 + 4 * k + 3] + move[k];
  body.bones.forEach(([a, b], i) => { for (let k = 0; k < 3; k++) { body.ends[i * 6 + k] = at(a, k); body.ends[i * 6 + 3 + k] = at(b, k); } });
  gl.useProgram(lines.made);
  gl.bindVertexArray(body.lineArray); gl.bindBuffer(gl.ARRAY_BUFFER, body.lineBuffer); gl.bufferSubData(gl.ARRAY_BUFFER, 0, body.ends);
  gl.uniformMatrix4fv(lines.uniforms.camera, false, camera); gl.uniform2f(lines.uniforms.size, canvas.width, canvas.height);
  for (const [width, tone] of [[7, [1, 1, 1, 0.9]], [4, index ? [0.25, 0.30, 0.36, 1] : [0.55, 0.13, 0.36, 1]]]) {
    gl.uniform1f(lines.uniforms.width, width * (window.devicePixelRatio || 1)); gl.uniform4fv(lines.uniforms.tone, tone);
    gl.drawArraysInstanced(gl.TRIANGLES, 0, 6, body.bones.length);
  }
};
const highlight = (body, joint, {camera, right, up, distance}) => {
  const move = body.given.moves[state.layout], at = [0, 1, 2].map((k) => sizeOf(body) * body.world[joint * 12 + 4 * k + 3] + move[k]), half = 0.008 * distance;
  body.ends.set([...at.map((v, k) => v - right[k] * half), ...at.map((v, k) => v + right[k] * half)]);
  gl.useProgram(lines.made); gl.bindVertexArray(body.lineArray); gl.bindBuffer(gl.ARRAY_BUFFER, body.lineBuffer);
  gl.bufferSubData(gl.ARRAY_BUFFER, 0, body.ends);
  gl.uniformMatrix4fv(lines.uniforms.camera, false, camera); gl.uniform2f(lines.uniforms.size, canvas.width, canvas.height);
  gl.uniform1f(lines.uniforms.width, 16); gl.uniform4f(lines.uniforms.tone, 0.84, 0.1, 0.1, 1);
  gl.drawArraysInstanced(gl.TRIANGLES, 0, 6, 1);
};
const draw = () => {
  const scale = window.devicePixelRatio || 1, wide = Math.round(canvas.clientWidth * scale), high = Math.round(canvas.clientHeight * scale);
  if (canvas.width !== wide || canvas.height !== high) { canvas.width = wide; canvas.height = high; }
  const tones = night.matches ? TONES.dark : TONES.light;
  gl.viewport(0, 0, wide, high); gl.clearColor(...tones.back, 1); gl.clearStencil(0); gl.depthMask(true);
  gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT | gl.STENCIL_BUFFER_BIT);
  const eye = look(), shown = bodies.map((body, i) => [body, i]).filter(([, i]) => state.shown[i]);
  shown.forEach(([body]) => pose(body, state.time));
  gl.disable(gl.DEPTH_TEST); gl.enable(gl.BLEND); gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
  gl.useProgram(ground.made); gl.bindVertexArray(null);
  gl.uniformMatrix4fv(ground.uniforms.camera, false, eye.camera); gl.uniform3fv(ground.uniforms.middle, eye.middle); gl.uniform3fv(ground.uniforms.back, tones.back);
  gl.uniform3fv(ground.uniforms.floor_tone, tones.floor); gl.uniform3fv(ground.uniforms.line_tone, tones.line);
  gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  gl.useProgram(skins.made);
  if (state.mesh) {
    gl.enable(gl.STENCIL_TEST); gl.stencilFunc(gl.EQUAL, 0, 255); gl.stencilOp(gl.KEEP, gl.KEEP, gl.INCR);
    if (state.pitch > 0) shown.forEach(([body]) => surface(body, eye, true, 1));
    gl.disable(gl.STENCIL_TEST); gl.enable(gl.DEPTH_TEST); gl.depthFunc(gl.LEQUAL);
    for (const [body, i] of [...shown].reverse()) {  // the result last: laid over its sources it is of glass
      const faint = state.layout % 2 === 1 && i === 0 && shown.length > 1;
      if (faint) { gl.colorMask(false, false, false, false); surface(body, eye, false, 1); gl.colorMask(true, true, true, true); }
      surface(body, eye, false, faint ? 0.45 : 1);
    }
  }
  if (state.sensors) {
    const u = skins.uniforms;
    gl.uniform1i(u.shadow, false); gl.uniform1i(u.flat_shaded, true); gl.uniform3f(u.flat_color, 1, 1, 1); gl.uniform1f(u.dot_size, 7 * scale);
    for (const [body] of shown) if (body.sensors) {
      gl.bindTexture(gl.TEXTURE_2D, body.texture); gl.uniform3fv(u.move, body.given.moves[state.layout]); gl.uniform1f(u.size, sizeOf(body));
      gl.bindVertexArray(body.sensors.array); gl.drawArrays(gl.POINTS, 0, body.sensors.count);
    }
  }
  gl.disable(gl.DEPTH_TEST);
  if (state.bones) shown.forEach(([body, i]) => skeleton(body, i, eye));
  if (state.lit) shown.forEach(([body, i]) => { if (state.lit[i] >= 0) highlight(body, state.lit[i], eye); });
  state.drawn++;
};

// --- controls ---------------------------------------------------------------------------------------------------
const heads = [...document.querySelectorAll(".playhead")];
const show = () => {
  const share = seconds > 0 ? state.time / seconds : 0;
  byId("scrub").value = String(Math.round(share * 10000));
  byId("clock").textContent = `${state.time.toFixed(2)} / ${seconds.toFixed(2)} s`;
  byId("play").textContent = state.playing ? "❚❚" : "▶";
  byId("play").setAttribute("aria-label", state.playing ? "pause" : "play");
  for (const head of heads) head.setAttribute("transform", `translate(${(share * Number(head.dataset.width)).toFixed(2)} 0)`);
};
let before = null;
const tick = (now) => {
  if (state.playing && before !== null && seconds > 0) {
    state.time = (state.time + Math.min(now - before, 250) / 1000 * state.speed) % seconds;
    state.dirty = true;
  }
  before = now;
  if (state.dirty) { state.dirty = false; show(); if (gl) draw(); }
  requestAnimationFrame(tick);
};
const change = (what) => { Object.assign(state, what); state.dirty = true; };
const seek = (time) => change({time: Math.min(Math.max(time, 0), seconds)});
byId("play").onclick = () => change({playing: !state.playing});
byId("scrub").oninput = (event) => { change({playing: false}); seek(event.target.value / 10000 * seconds); };
byId("speed").onchange = (event) => change({speed: Number(event.target.value)});
byId("layout").onchange = (event) => change({layout: Number(event.target.value)});
byId("color").onchange = (event) => {
  for (const body of bodies) { gl.bindBuffer(gl.ARRAY_BUFFER, body.tint); gl.bufferSubData(gl.ARRAY_BUFFER, 0, body.tints[event.target.value]); }
  change({color: event.target.value});
};
for (const name of ["mesh", "bones", "sensors", "spots", "follow"]) byId(name).onchange = (event) => change({[name]: event.target.checked});
document.querySelectorAll("[data-body]").forEach((box) => { box.onchange = () => { state.shown[Number(box.dataset.body)] = box.checked; state.dirty = true; }; });
document.querySelectorAll("[data-time]").forEach((link) => { link.onclick = () => { change({playing: false}); seek(Number(link.dataset.time)); canvas.scrollIntoView({block: "nearest"}); }; });
document.querySelectorAll("svg[data-left]").forEach((chart) => { chart.onclick = (event) => {
  const box = chart.getBoundingClientRect(), x = (event.clientX - box.left) / box.width * Number(chart.dataset.whole);
  change({playing: false}); seek((x - Number(chart.dataset.left)) / Number(chart.dataset.plot) * seconds); }; });
document.querySelectorAll("[data-joints]").forEach((row) => {
  row.onmouseenter = () => change({lit: JSON.parse(row.dataset.joints)}); row.onmouseleave = () => change({lit: null}); });
document.addEventListener("keydown", (event) => {
  if (["INPUT", "SELECT"].includes(event.target.tagName) && event.target.type !== "checkbox" && event.key !== " ") return;
  const step = {ArrowLeft: -1, ArrowRight: 1}[event.key];
  if (event.key === " ") { event.preventDefault(); change({playing: !state.playing}); }
  else if (step) { change({playing: false}); seek((Math.round(state.time * page.fps) + step) / page.fps); }
});
let held = null;
canvas.onpointerdown = (event) => { held = [event.clientX, event.clientY, event.shiftKey || event.button === 2]; canvas.setPointerCapture(event.pointerId); };
canvas.onpointerup = canvas.onpointercancel = () => { held = null; };
canvas.oncontextmenu = (event) => event.preventDefault();
canvas.onpointermove = (event) => {
  if (!held) return;
  const [x, y, moves] = held, right = event.clientX - x, down = event.clientY - y;
  held = [event.clientX, event.clientY, moves];
  if (moves) {
    const eye = look(), metre = 2 * eye.distance * Math.tan(FIELD / 2) / canvas.clientHeight;
    change({pan: state.pan.map((v, k) => v - eye.right[k] * right * metre + eye.up[k] * down * metre)});
  } else change({yaw: state.yaw - right * 0.008, pitch: Math.min(Math.max(state.pitch + down * 0.008, -0.3), 1.5)});
};
canvas.addEventListener("wheel", (event) => { event.preventDefault(); change({zoom: Math.min(Math.max(state.zoom * Math.exp(event.deltaY * 0.001), 0.1), 10)}); }, {passive: false});
canvas.ondblclick = () => change({yaw: page.yaw, pitch: 0.15, zoom: 1, pan: [0, 0, 0]});
night.addEventListener("change", () => { state.dirty = true; });
addEventListener("resize", () => { state.dirty = true; });
const hash = () => {  // report.html#t=2.4 opens the clip still, at that second
  const found = /t=([\d.]+)/.exec(location.hash);
  if (found) { change({playing: false}); seek(Number(found[1])); }
};
addEventListener("hashchange", hash);
hash();
window.stage = {state, bodies, change, seek, draw: () => { state.dirty = false; show(); if (gl) draw(); }, seconds};
requestAnimationFrame(tick);
})();
