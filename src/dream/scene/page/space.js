// A scene in three dimensions: with WebGL 2 where a browser has it, else flat. Metres, east, north and up.

const NEVER_AT = 65535;
const [OTHER, UNSEEN, SEEN, INSPECTED] = [0, 1, 2, 3];
// Metres: how far the edges of the picture's pyramid are drawn.
const PYRAMID_M = 3;
const SQUARE_M = 5;
const LENS = (34 * Math.PI) / 180;
const MOST_PIXELS = 2.4e6;
const MOVE_MS = 350;
// A computer that takes longer for a picture is slow; a view that was left alone for so long stands still.
const SLOW_MS = 50;
const SETTLED_MS = 180;

// ---- numbers

const KINDS_OF_NUMBER = { u1: Uint8Array, u2: Uint16Array, u4: Uint32Array, f4: Float32Array };

function unpacked({ type, data }) {
  const letters = atob(data);
  const bytes = new Uint8Array(letters.length);
  for (let index = 0; index < bytes.length; index++) bytes[index] = letters.charCodeAt(index);
  return new KINDS_OF_NUMBER[type](bytes.buffer);
}

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const plus = (a, b, share = 1) => [a[0] + share * b[0], a[1] + share * b[1], a[2] + share * b[2]];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const clamp = (value, least, most) => Math.min(most, Math.max(least, value));

// Columns one after another, as WebGL takes them.
function times(a, b) {
  const product = new Float32Array(16);
  for (let column = 0; column < 4; column++)
    for (let row = 0; row < 4; row++)
      for (let k = 0; k < 4; k++) product[4 * column + row] += a[4 * k + row] * b[4 * column + k];
  return product;
}

// ---- what is shown

// The scene of the page with its arrays unpacked.
class SceneData {
  constructor(packed) {
    const { title, bounds, water, legend, kinds, low, step } = packed;
    Object.assign(this, { title, bounds, water, legend, kinds, low, step, fieldOfView: packed.field_of_view });
    for (const name of ["kind", "seen_at", "inspected_at"]) this[name] = unpacked(packed[name]);
    this.surfaces = Object.fromEntries(Object.entries(packed.surfaces).map(([name, { positions, faces }]) => [name, { positions: unpacked(positions), faces: unpacked(faces) }]));
    if (this.surfaces.targets) this.surfaces.targets.when = this.whenOf(unpacked(packed.vertices));
    this.voxels = packed.voxels && {
      size: packed.voxels.size,
      low: packed.voxels.low,
      ...Object.fromEntries(["cells", "sides", "target", "seen_at", "inspected_at"].map((name) => [name, unpacked(packed.voxels[name])])),
    };
    const { path } = packed;
    this.path = { step: path.step, positions: unpacked(path.positions), yaw: unpacked(path.yaw), tilt: unpacked(path.tilt), collided: path.collided };
  }

  // For each vertex of a target the steps at which its individual was seen and inspected.
  whenOf(counts) {
    const total = counts.reduce((sum, count) => sum + count, 0);
    const when = new Uint16Array(2 * total);
    let vertex = 0;
    counts.forEach((count, individual) => {
      for (let last = vertex + count; vertex < last; vertex++) {
        when[2 * vertex] = this.seen_at[individual];
        when[2 * vertex + 1] = this.inspected_at[individual];
      }
    });
    return when;
  }

  place(surface, vertex) {
    return this.low.map((least, axis) => least + this.step[axis] * surface.positions[3 * vertex + axis]);
  }

  at(index) {
    return Array.from(this.path.positions.subarray(3 * index, 3 * index + 3));
  }

  // Index into the path of the last step that is not later; −1 where there is none.
  indexAt(step) {
    let index = this.path.step.length - 1;
    while (index >= 0 && this.path.step[index] > step) index--;
    return index;
  }

  // Of each kind how many there are, and how many are seen and inspected at a step.
  counts(step) {
    const counts = this.kinds.map((name) => ({ name, all: 0, seen: 0, inspected: 0 }));
    this.kind.forEach((kind, individual) => {
      counts[kind].all++;
      if (this.seen_at[individual] <= step) counts[kind].seen++;
      if (this.inspected_at[individual] <= step) counts[kind].inspected++;
    });
    return counts;
  }

  // Lowest and highest corner of what a reader wants to see: targets or map, and the way.
  extent() {
    const low = [Infinity, Infinity, Infinity];
    const high = [-Infinity, -Infinity, -Infinity];
    const take = (point) => point.forEach((value, axis) => {
      low[axis] = Math.min(low[axis], value);
      high[axis] = Math.max(high[axis], value);
    });
    const { targets } = this.surfaces;
    if (targets) for (let vertex = 0; vertex < targets.positions.length / 3; vertex++) take(this.place(targets, vertex));
    else if (this.voxels) for (let voxel = 0; voxel < this.voxels.sides.length; voxel++) take(this.middle(voxel));
    for (let index = 0; index < this.path.step.length; index++) take(this.at(index));
    return low[0] <= high[0] ? [low, high] : this.bounds;
  }

  middle(voxel) {
    const { low, size, cells } = this.voxels;
    return low.map((least, axis) => least + size * cells[3 * voxel + axis]);
  }
}

// Axes of the camera at a step: ahead, right and down.
function axesOf(yaw, tilt) {
  const ahead = [Math.cos(yaw) * Math.cos(tilt), Math.sin(yaw) * Math.cos(tilt), -Math.sin(tilt)];
  const right = [Math.sin(yaw), -Math.cos(yaw), 0];
  return { ahead, right, down: cross(ahead, right) };
}

// The four corners of a picture, so many metres ahead.
function pyramid(scene, index, length) {
  const { ahead, right, down } = axesOf(scene.path.yaw[index], scene.path.tilt[index]);
  const [across, up] = scene.fieldOfView.map((angle) => length * Math.tan(angle / 2));
  const middle = plus(scene.at(index), ahead, length);
  return [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([x, y]) => plus(plus(middle, right, x * across), down, y * up));
}

// ---- where the reader looks from

class Orbit {
  constructor() {
    this.aspect = 1;
  }

  // What is to be looked at.
  open(scene) {
    this.box = scene.extent();
    const [low, high] = this.box;
    this.size = Math.max(1, Math.hypot(...low.map((value, axis) => high[axis] - value)));
    // From the side, the longer of the two extents lies across the picture.
    this.side = high[0] - low[0] >= high[1] - low[1] ? -Math.PI / 2 : 0;
  }

  take({ target, distance, azimuth, elevation }) {
    Object.assign(this, { target, distance, azimuth, elevation });
  }

  get state() {
    const { target, distance, azimuth, elevation } = this;
    return { target, distance, azimuth, elevation };
  }

  axes({ azimuth, elevation } = this) {
    const [c, s] = [Math.cos(elevation), Math.sin(elevation)];
    const back = [c * Math.cos(azimuth), c * Math.sin(azimuth), s];
    const up = [-s * Math.cos(azimuth), -s * Math.sin(azimuth), c];
    return { back, up, right: cross(up, back) };
  }

  // All of the box, from a direction.
  preset(name) {
    const angles = {
      oblique: { azimuth: this.side - 0.5, elevation: 0.56 },
      side: { azimuth: this.side, elevation: 0.06 },
      above: { azimuth: -Math.PI / 2, elevation: Math.PI / 2 },
    }[name];
    const [low, high] = this.box;
    const target = low.map((value, axis) => (value + high[axis]) / 2);
    const { back, up, right } = this.axes(angles);
    const tall = Math.tan(LENS / 2);
    let distance = 1;
    for (let corner = 0; corner < 8; corner++) {
      const place = [0, 1, 2].map((axis) => this.box[(corner >> axis) & 1][axis] - target[axis]);
      const far = Math.max(Math.abs(dot(place, up)) / tall, Math.abs(dot(place, right)) / (tall * this.aspect));
      distance = Math.max(distance, dot(place, back) + far);
    }
    return { target, distance: 1.06 * distance, ...angles };
  }

  // Over the vehicle's shoulder.
  behind(scene, index) {
    const yaw = scene.path.yaw[index];
    const { ahead } = axesOf(yaw, scene.path.tilt[index]);
    return { target: plus(scene.at(index), ahead, 2), distance: 9, azimuth: yaw + Math.PI, elevation: scene.path.tilt[index] + 0.2 };
  }

  get eye() {
    return plus(this.target, this.axes().back, this.distance);
  }

  turn(azimuth, elevation) {
    this.azimuth += azimuth;
    this.elevation = clamp(this.elevation + elevation, -0.5, Math.PI / 2);
  }

  zoom(factor) {
    this.distance = clamp(this.distance * factor, 0.5, 6 * this.size);
  }

  // By shares of the picture's height.
  pan(right, up) {
    const axes = this.axes();
    const metres = 2 * this.distance * Math.tan(LENS / 2);
    const moved = plus(plus(this.target, axes.right, -right * metres), axes.up, -up * metres);
    this.target = moved.map((value, axis) => clamp(value, this.box[0][axis] - this.size, this.box[1][axis] + this.size));
  }

  // From the world, less an origin, to the screen.
  matrix(origin) {
    const { back, up, right } = this.axes();
    const eye = plus(this.eye, origin, -1);
    const view = [right[0], up[0], back[0], 0, right[1], up[1], back[1], 0, right[2], up[2], back[2], 0, -dot(right, eye), -dot(up, eye), -dot(back, eye), 1];
    const near = Math.max(0.05, 0.02 * this.distance);
    const far = this.distance + 5 * this.size + 200;
    const f = 1 / Math.tan(LENS / 2);
    const lens = [f / this.aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / (near - far), -1, 0, 0, (2 * far * near) / (near - far), 0];
    return times(lens, view);
  }
}

// ---- colours

const THEMES = {
  light: { water: [228, 236, 239], path: [22, 82, 214], casing: [255, 255, 255], faint: [86, 108, 122], vehicle: [255, 214, 10], bad: [208, 20, 30] },
  dark: { water: [9, 26, 37], path: [116, 178, 255], casing: [4, 14, 22], faint: [108, 136, 150], vehicle: [255, 222, 60], bad: [255, 92, 88] },
};
const dark = matchMedia("(prefers-color-scheme: dark)");
const theme = () => THEMES[dark.matches ? "dark" : "light"];
const css = (color, opacity = 1) => `rgb(${color.join(" ")} / ${opacity})`;
const unit = (color) => color.map((level) => level / 255);

// ---- drawing with WebGL 2

const SURFACE_VERTEX = `#version 300 es
layout(location = 0) in vec3 a_place;
layout(location = 1) in vec2 a_when;
uniform mat4 u_matrix;
uniform vec3 u_low, u_scale;
uniform float u_step;
uniform int u_target;
out vec3 v_position;
flat out int v_state;
void main() {
  v_position = u_low + u_scale * a_place;
  v_state = u_target == 0 ? 0 : u_step >= a_when.y ? 3 : u_step >= a_when.x ? 2 : 1;
  gl_Position = u_matrix * vec4(v_position, 1.0);
}`;
const VOXEL_VERTEX = `#version 300 es
layout(location = 0) in vec3 a_cell;
layout(location = 1) in vec2 a_when;
layout(location = 2) in vec2 a_what;
uniform mat4 u_matrix;
uniform vec3 u_low, u_scale;
uniform float u_step;
out vec3 v_position;
out vec2 v_square;
flat out int v_state;
void main() {
  vec2 corner = vec2(gl_VertexID & 1, (gl_VertexID >> 1) & 1);
  int side = int(a_what.x);
  float outwards = (side & 1) == 0 ? 0.5 : -0.5;
  vec2 half_way = corner - 0.5;
  vec3 offset = side < 2 ? vec3(outwards, half_way) : side < 4 ? vec3(half_way.y, outwards, half_way.x) : vec3(half_way, outwards);
  v_position = u_low + u_scale * (a_cell + offset);
  v_square = corner;
  v_state = a_what.y < 0.5 ? 0 : u_step >= a_when.y ? 3 : 2;
  gl_Position = u_step >= a_when.x ? u_matrix * vec4(v_position, 1.0) : vec4(0.0, 0.0, 2.0, 1.0);
}`;
// Faces are lit as they lie: their normals come from their neighbours on the screen. What is not yet seen is striped.
const SOLID_FRAGMENT = (voxels) => `#version 300 es
precision highp float;
uniform vec3 u_eye, u_light, u_colors[4];
uniform vec2 u_origin;
uniform float u_square, u_opacity;
in vec3 v_position;
${voxels ? "in vec2 v_square;" : ""}
flat in int v_state;
out vec4 color;
float lines(vec2 place) {
  vec2 pace = max(fwidth(place), 1e-6);
  vec2 away = abs(fract(place - 0.5) - 0.5) / pace;
  vec2 line = clamp(1.3 - away, 0.0, 1.0) * (1.0 - smoothstep(0.15, 0.4, pace));
  return max(line.x, line.y);
}
void main() {
  vec3 towards = u_eye - v_position;
  vec3 normal = normalize(cross(dFdx(v_position), dFdy(v_position)));
  if (dot(normal, towards) < 0.0) normal = -normal;
  vec3 base = u_colors[v_state];
  if (v_state == 1) {
    float place = (v_position.x + v_position.y + 1.4 * v_position.z) * 2.5;
    float pace = fwidth(place);
    float wave = abs(fract(place) - 0.5) * 2.0;
    float stripe = smoothstep(0.62 - pace, 0.62 + pace, wave) * (1.0 - smoothstep(0.35, 0.8, pace));
    base = mix(base, mix(base, vec3(1.0), 0.22), stripe);
  }
  if (u_square > 0.0) base *= 1.0 - 0.22 * lines((v_position.xy + u_origin) / u_square);
  ${voxels ? "base *= 1.0 - 0.3 * lines(v_square);" : ""}
  float lit = 0.62 + 0.34 * max(0.0, dot(normal, u_light)) + 0.10 * normal.z;
  color = vec4(base * lit, 1.0) * u_opacity;
}`;
const LINE_VERTEX = `#version 300 es
layout(location = 0) in vec3 a_from;
layout(location = 1) in vec3 a_to;
layout(location = 2) in float a_step;
uniform mat4 u_matrix;
uniform vec2 u_screen, u_steps;
uniform float u_width, u_lift;
void main() {
  vec4 from = u_matrix * vec4(a_from, 1.0), to = u_matrix * vec4(a_to, 1.0);
  float near = 0.01;
  if (a_step < u_steps.x || a_step > u_steps.y || (from.w < near && to.w < near)) {
    gl_Position = vec4(0.0, 0.0, 2.0, 1.0);
    return;
  }
  vec4 first = from.w < near ? mix(from, to, (near - from.w) / (to.w - from.w)) : from;
  vec4 second = to.w < near ? mix(to, from, (near - to.w) / (from.w - to.w)) : to;
  vec2 along = (second.xy / second.w - first.xy / first.w) * u_screen;
  along = dot(along, along) > 1e-6 ? normalize(along) : vec2(1.0, 0.0);
  float end = float(gl_VertexID & 1), side = float(gl_VertexID >> 1) * 2.0 - 1.0;
  vec4 place = end > 0.5 ? second : first;
  vec2 aside = side * vec2(-along.y, along.x) + (2.0 * end - 1.0) * along;
  gl_Position = place + vec4(aside * u_width / u_screen, -u_lift, 0.0) * place.w;
}`;
const LINE_FRAGMENT = `#version 300 es
precision mediump float;
uniform vec4 u_color;
out vec4 color;
void main() { color = vec4(u_color.rgb * u_color.a, u_color.a); }`;

class Solid {
  constructor(canvas, lost) {
    const gl = canvas.getContext("webgl2", { antialias: true, alpha: false, powerPreference: "low-power" });
    if (!gl) throw new Error("no WebGL 2");
    Object.assign(this, { canvas, gl });
    this.programs = {
      surface: this.program(SURFACE_VERTEX, SOLID_FRAGMENT(false)),
      voxel: this.program(VOXEL_VERTEX, SOLID_FRAGMENT(true)),
      line: this.program(LINE_VERTEX, LINE_FRAGMENT),
    };
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      lost();
    }, { once: true });
  }

  program(...sources) {
    const { gl } = this;
    const program = gl.createProgram();
    sources.forEach((source, index) => {
      const shader = gl.createShader(index === 0 ? gl.VERTEX_SHADER : gl.FRAGMENT_SHADER);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    });
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(`${gl.getProgramInfoLog(program)} ${gl.getAttachedShaders(program).map((shader) => gl.getShaderInfoLog(shader))}`);
    const places = new Map();
    const count = gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS);
    for (let index = 0; index < count; index++) {
      const { name } = gl.getActiveUniform(program, index);
      places.set(name, gl.getUniformLocation(program, name));
    }
    return { program, places };
  }

  use(name, uniforms) {
    const { gl } = this;
    const { program, places } = this.programs[name];
    gl.useProgram(program);
    for (const [uniform, value] of Object.entries(uniforms)) {
      const place = places.get(uniform) ?? places.get(`${uniform}[0]`);
      if (place === undefined) continue;
      if (uniform === "u_matrix") gl.uniformMatrix4fv(place, false, value);
      else if (uniform === "u_colors") gl.uniform3fv(place, value);
      else if (uniform === "u_target") gl.uniform1i(place, value);
      else if (typeof value === "number") gl.uniform1f(place, value);
      else gl[`uniform${value.length}fv`](place, value);
    }
  }

  buffer(values, target = this.gl.ARRAY_BUFFER) {
    const { gl } = this;
    const buffer = gl.createBuffer();
    gl.bindBuffer(target, buffer);
    gl.bufferData(target, values, gl.STATIC_DRAW);
    return buffer;
  }

  // An array object with some attributes: [place, numbers each, values, per instance].
  arrays(attributes, faces = null) {
    const { gl } = this;
    const object = gl.createVertexArray();
    gl.bindVertexArray(object);
    const buffers = attributes.map(([place, size, values, each = 0]) => {
      const buffer = this.buffer(values);
      const type = { 1: gl.UNSIGNED_BYTE, 2: gl.UNSIGNED_SHORT, 4: gl.FLOAT }[values.BYTES_PER_ELEMENT];
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, size, type, false, 0, 0);
      gl.vertexAttribDivisor(place, each);
      return buffer;
    });
    if (faces) buffers.push(this.buffer(faces, gl.ELEMENT_ARRAY_BUFFER));
    gl.bindVertexArray(null);
    return { object, buffers };
  }

  drop(part) {
    if (!part) return;
    this.gl.deleteVertexArray(part.object);
    part.buffers.forEach((buffer) => this.gl.deleteBuffer(buffer));
  }

  // Hand the scene's arrays over; numbers are counted from its middle, so that they stay exact.
  open(scene) {
    const { gl } = this;
    for (const part of [...Object.values(this.surfaces ?? {}), this.voxels, this.lines, this.frame]) this.drop(part);
    this.scene = scene;
    this.origin = scene.bounds[0].map((value, axis) => (value + scene.bounds[1][axis]) / 2);
    this.surfaces = Object.fromEntries(Object.entries(scene.surfaces).map(([name, { positions, faces, when }]) => {
      const attributes = [[0, 3, positions], ...(when ? [[1, 2, when]] : [])];
      const type = faces.BYTES_PER_ELEMENT === 2 ? gl.UNSIGNED_SHORT : gl.UNSIGNED_INT;
      return [name, { ...this.arrays(attributes, faces), count: faces.length, type }];
    }));
    this.voxels = scene.voxels && this.sides(scene.voxels);
    const { path } = scene;
    const points = path.step.map((_, index) => plus(scene.at(index), this.origin, -1));
    this.lines = this.segments(points.slice(1).map((point, index) => [points[index], point, path.step[index + 1]]));
    this.frame = this.segments(this.frameOf(scene));
  }

  // Pairs of ends, relative to the origin, each with a step.
  segments(pairs) {
    const [from, to, steps] = [new Float32Array(3 * pairs.length), new Float32Array(3 * pairs.length), new Float32Array(pairs.length)];
    pairs.forEach(([first, second, step = 0], index) => {
      from.set(first, 3 * index);
      to.set(second, 3 * index);
      steps[index] = step;
    });
    return { ...this.arrays([[0, 3, from, 1], [1, 3, to, 1], [2, 1, steps, 1]]), count: pairs.length };
  }

  // The operator's box; below it, where no seabed is known, squares.
  frameOf(scene) {
    const [low, high] = scene.bounds.map((corner) => plus(corner, this.origin, -1));
    const water = scene.water - this.origin[2];
    const corners = [[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]];
    const pairs = corners.flatMap(([x, y], index) => {
      const [nextX, nextY] = corners[(index + 1) % 4];
      return [[[x, y, water], [nextX, nextY, water]], [[x, y, low[2]], [nextX, nextY, low[2]]], [[x, y, low[2]], [x, y, water]]];
    });
    if (scene.surfaces.seabed) return pairs;
    const lines = (axis) => {
      const values = [];
      for (let value = Math.ceil(scene.bounds[0][axis] / SQUARE_M) * SQUARE_M; value < scene.bounds[1][axis]; value += SQUARE_M) values.push(value - this.origin[axis]);
      return values;
    };
    return [...pairs, ...lines(0).map((x) => [[x, low[1], low[2]], [x, high[1], low[2]]]), ...lines(1).map((y) => [[low[0], y, low[2]], [high[0], y, low[2]]])];
  }

  // Those sides of the voxels that can be looked at: four vertices each, since a processor that draws by software
  // is slow at instances.
  sides({ cells, sides, target, seen_at: seen, inspected_at: inspected }) {
    let count = 0;
    for (const bits of sides) for (let side = 0; side < 6; side++) count += (bits >> side) & 1;
    const [place, when, what] = [new Uint16Array(12 * count), new Uint16Array(8 * count), new Uint8Array(8 * count)];
    const faces = new Uint32Array(6 * count);
    const begins = [];
    let vertex = 0;
    for (let side = 0; side < 6; side++) {
      begins.push(1.5 * vertex);
      sides.forEach((bits, voxel) => {
        if (!((bits >> side) & 1)) return;
        const corners = side & 1 ? [0, 2, 1, 1, 2, 3] : [0, 1, 2, 2, 1, 3];
        for (let corner = 0; corner < 6; corner++) faces[1.5 * vertex + corner] = vertex + corners[corner];
        for (let last = vertex + 4; vertex < last; vertex++) {
          for (let axis = 0; axis < 3; axis++) place[3 * vertex + axis] = cells[3 * voxel + axis];
          when[2 * vertex] = seen[voxel];
          when[2 * vertex + 1] = inspected[voxel];
          what[2 * vertex] = side;
          what[2 * vertex + 1] = target[voxel];
        }
      });
    }
    const highest = [0, 1, 2].map((axis) => cells.reduce((most, cell, at) => (at % 3 === axis ? Math.max(most, cell) : most), 0));
    return { ...this.arrays([[0, 3, place], [1, 2, when], [2, 2, what]], faces), begins: [...begins, faces.length], highest };
  }

  // `share` of the pixels along either side.
  resize(share) {
    const { canvas } = this;
    const box = canvas.getBoundingClientRect();
    const sharp = share * Math.min(devicePixelRatio, 2, Math.sqrt(MOST_PIXELS / Math.max(1, box.width * box.height)));
    const [width, height] = [box.width, box.height].map((side) => Math.max(1, Math.round(side * sharp)));
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    this.sharp = sharp;
    return width / height;
  }

  draw(orbit, step, layers) {
    const { gl, scene, origin, canvas } = this;
    const colors = theme();
    const matrix = orbit.matrix(origin);
    const { back, up, right } = orbit.axes();
    const sun = plus(plus(plus([0, 0, 0.9], back, 0.8), right, -0.7), up, 0.3);
    const light = sun.map((value) => value / Math.hypot(...sun));
    const states = scene.legend.flatMap(({ color }) => unit(color));
    const solid = { u_matrix: matrix, u_eye: plus(orbit.eye, origin, -1), u_light: light, u_colors: states, u_origin: origin.slice(0, 2), u_step: step, u_square: 0, u_opacity: 1 };
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(...unit(colors.water), 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.disable(gl.BLEND);
    if (layers.truth) {
      const low = plus(scene.low, origin, -1);
      for (const [name, { object, count, type }] of Object.entries(this.surfaces)) {
        this.use("surface", { ...solid, u_low: low, u_scale: scene.step, u_target: name === "targets" ? 1 : 0, u_square: name === "seabed" ? SQUARE_M : 0 });
        gl.bindVertexArray(object);
        gl.drawElements(gl.TRIANGLES, count, type, 0);
      }
    }
    if (layers.mapped && this.voxels) {
      const { low, size } = scene.voxels;
      this.use("voxel", { ...solid, u_low: plus(low, origin, -1), u_scale: [size, size, size] });
      gl.bindVertexArray(this.voxels.object);
      gl.enable(gl.CULL_FACE);
      const { begins, highest } = this.voxels;
      for (let side = 0; side < 6; side++) {
        // No side can be seen from behind.
        const axis = side >> 1;
        const eye = (orbit.eye[axis] - low[axis]) / size;
        const shows = side & 1 ? eye < highest[axis] - 0.5 : eye > 0.5;
        if (shows) gl.drawElements(gl.TRIANGLES, begins[side + 1] - begins[side], gl.UNSIGNED_INT, 4 * begins[side]);
      }
      gl.disable(gl.CULL_FACE);
    }
    const line = { u_matrix: matrix, u_screen: [canvas.width, canvas.height], u_steps: [-1, NEVER_AT] };
    // Of two lines in one place the narrower one is drawn a little nearer.
    const stroke = (part, color, width, opacity = 1, steps = [-1, NEVER_AT]) => {
      if (!part.count) return;
      this.use("line", { ...line, u_color: [...unit(color), opacity], u_width: width * this.sharp, u_lift: 2e-3 / width, u_steps: steps });
      gl.bindVertexArray(part.object);
      gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, part.count);
    };
    gl.enable(gl.BLEND);
    stroke(this.frame, colors.faint, 1, 0.5);
    if (!layers.path) return;
    stroke(this.lines, colors.path, 1.2, 0.4, [step + 0.5, NEVER_AT]);
    // Behind what is solid it shines through.
    gl.disable(gl.DEPTH_TEST);
    stroke(this.lines, colors.path, 1.5, 0.35, [-1, step]);
    gl.enable(gl.DEPTH_TEST);
    stroke(this.lines, colors.casing, 5, 1, [-1, step]);
    stroke(this.lines, colors.path, 2.6, 1, [-1, step]);
    this.drawMarks(stroke, solid, colors, step, orbit);
  }

  // Contacts, and the vehicle with what its camera takes in.
  drawMarks(stroke, solid, colors, step, orbit) {
    const { gl, scene, origin } = this;
    const { right, up, back } = orbit.axes();
    const metresPerPixel = (point) => (2 * Math.tan(LENS / 2) * Math.max(0.1, dot(plus(orbit.eye, point, -1), back)) * this.sharp) / this.canvas.height;
    const relative = (point) => plus(point, origin, -1);
    const marks = scene.path.collided.filter((index) => scene.path.step[index] <= step).flatMap((index) => {
      const place = scene.at(index);
      const arm = 7 * metresPerPixel(place);
      const end = (x, y) => relative(plus(plus(place, right, x * arm), up, y * arm));
      return [[end(-1, -1), end(1, 1)], [end(-1, 1), end(1, -1)]];
    });
    const draw = (pairs, ...how) => {
      const part = this.segments(pairs);
      stroke(part, ...how);
      this.drop(part);
    };
    gl.disable(gl.DEPTH_TEST);
    draw(marks, colors.casing, 6);
    draw(marks, colors.bad, 3.2);
    gl.enable(gl.DEPTH_TEST);
    const index = scene.indexAt(step);
    if (index < 0) return;
    const place = scene.at(index);
    const corners = pyramid(scene, index, PYRAMID_M).map(relative);
    const from = relative(place);
    const edges = corners.flatMap((corner, side) => [[from, corner], [corner, corners[(side + 1) % 4]]]);
    this.triangles(corners.flatMap((corner, side) => [from, corner, corners[(side + 1) % 4]]), { ...solid, u_opacity: 0.16 }, colors.vehicle);
    draw(edges, colors.casing, 4, 0.9);
    draw(edges, colors.vehicle, 2);
    // The body: a dart that points ahead, never smaller than can be seen.
    const { ahead, right: aside } = axesOf(scene.path.yaw[index], 0);
    const size = Math.max(0.35, 9 * metresPerPixel(place));
    const body = (x, y, z) => relative(plus(plus(plus(place, ahead, x * size), aside, y * size), [0, 0, z * size]));
    const [nose, left, rightmost, top, bottom] = [body(1.3, 0, 0), body(-0.9, -0.8, 0), body(-0.9, 0.8, 0), body(-0.6, 0, 0.55), body(-0.6, 0, -0.4)];
    gl.depthFunc(gl.ALWAYS);
    draw([[nose, left], [nose, rightmost], [left, rightmost]], colors.casing, 5);
    gl.depthFunc(gl.LEQUAL);
    gl.disable(gl.BLEND);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    this.triangles([nose, left, top, nose, top, rightmost, left, rightmost, top, nose, bottom, left, nose, rightmost, bottom, left, bottom, rightmost], solid, colors.vehicle);
  }

  // Corners, three a face, in one colour.
  triangles(corners, solid, color) {
    const { gl } = this;
    const part = this.arrays([[0, 3, new Float32Array(corners.flat())]]);
    this.use("surface", { ...solid, u_low: [0, 0, 0], u_scale: [1, 1, 1], u_target: 0, u_colors: [...unit(color), ...new Array(9).fill(0)] });
    gl.bindVertexArray(part.object);
    gl.depthMask(solid.u_opacity === 1);
    gl.drawArrays(gl.TRIANGLES, 0, corners.length);
    gl.depthMask(true);
    this.drop(part);
  }
}

// ---- drawing without it: from above, and from the side

const MOST_DOTS = 60000;

class Flat {
  constructor(canvas) {
    Object.assign(this, { canvas, context: canvas.getContext("2d") });
  }

  open(scene) {
    this.scene = scene;
    const { targets, obstacles } = scene.surfaces;
    const dots = [];
    for (const [surface, is] of [[targets, true], [obstacles, false]]) {
      if (!surface) continue;
      const every = Math.ceil(surface.faces.length / 3 / MOST_DOTS);
      for (let face = 0; face < surface.faces.length; face += 3 * every) {
        const vertex = surface.faces[face];
        dots.push([scene.place(surface, vertex), is ? surface.when[2 * vertex] : NEVER_AT, is ? surface.when[2 * vertex + 1] : NEVER_AT, is]);
      }
    }
    this.truth = dots;
    this.mapped = [];
    if (scene.voxels) {
      const { sides, target, seen_at: seen, inspected_at: inspected } = scene.voxels;
      const every = Math.ceil(sides.length / MOST_DOTS);
      for (let voxel = 0; voxel < sides.length; voxel += every) this.mapped.push([scene.middle(voxel), seen[voxel], inspected[voxel], target[voxel] === 1]);
    }
    this.box = scene.extent();
    // From the side, the longer of the two extents lies across the picture.
    this.across = this.box[1][0] - this.box[0][0] >= this.box[1][1] - this.box[0][1] ? 0 : 1;
  }

  resize() {
    const { canvas } = this;
    const box = canvas.getBoundingClientRect();
    const sharp = Math.min(devicePixelRatio, 2);
    const [width, height] = [box.width, box.height].map((side) => Math.max(1, Math.round(side * sharp)));
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    this.sharp = sharp;
    return width / height;
  }

  draw(_, step, layers) {
    const { canvas, context, sharp } = this;
    const colors = theme();
    context.fillStyle = css(colors.water);
    context.fillRect(0, 0, canvas.width, canvas.height);
    const beside = canvas.width > 1.2 * canvas.height;
    const parts = beside
      ? [[0, 0, canvas.width / 2, canvas.height], [canvas.width / 2, 0, canvas.width / 2, canvas.height]]
      : [[0, 0, canvas.width, 0.6 * canvas.height], [0, 0.6 * canvas.height, canvas.width, 0.4 * canvas.height]];
    const side = this.across === 0 ? "From the south" : "From the east";
    this.drawPart(parts[0], [0, 1, 2], "From above, north is up", step, layers, colors);
    this.drawPart(parts[1], [this.across, 2, 1 - this.across], side, step, layers, colors);
    context.strokeStyle = css(colors.faint, 0.6);
    context.lineWidth = sharp;
    context.strokeRect(parts[1][0], parts[1][1], parts[1][2], parts[1][3]);
  }

  // `axes`: that across, that up, and that towards the reader.
  drawPart([left, top, width, height], [across, up, near], words, step, layers, colors) {
    const { context, scene, sharp } = this;
    const [low, high] = this.box;
    const title = 22 * sharp;
    const margin = 14 * sharp;
    const scale = Math.min((width - 2 * margin) / Math.max(1, high[across] - low[across]), (height - title - 2 * margin) / Math.max(1, high[up] - low[up]));
    const middle = [left + width / 2, top + title + (height - title) / 2];
    const place = (point) => [middle[0] + scale * (point[across] - (low[across] + high[across]) / 2), middle[1] - scale * (point[up] - (low[up] + high[up]) / 2)];
    context.save();
    context.beginPath();
    context.rect(left, top, width, height);
    context.clip();
    const dots = [...(layers.truth ? this.truth : []), ...(layers.mapped ? this.mapped.filter(([, seen]) => seen <= step) : [])];
    // What is nearer to the reader is drawn later: higher, or farther south or east.
    const order = near === 1 ? -1 : 1;
    dots.sort((a, b) => order * (a[0][near] - b[0][near]));
    const size = Math.max(2 * sharp, 0.3 * scale);
    for (const [point, seen, inspected, target] of dots) {
      const state = !target ? OTHER : inspected <= step ? INSPECTED : seen <= step ? SEEN : UNSEEN;
      const [x, y] = place(point);
      context.fillStyle = css(scene.legend[state].color);
      context.fillRect(x - size / 2, y - size / 2, size, size);
    }
    if (layers.path) this.drawPath(place, step, colors);
    context.fillStyle = css(colors.faint);
    context.font = `${12.5 * sharp}px system-ui, sans-serif`;
    context.fillText(words, left + 10 * sharp, top + 17 * sharp);
    const metres = 10 ** Math.floor(Math.log10(Math.max(1, (0.5 * width) / scale)));
    context.fillRect(left + 10 * sharp, top + height - 10 * sharp, metres * scale, 2 * sharp);
    context.fillText(`${metres} m`, left + 10 * sharp, top + height - 15 * sharp);
    context.restore();
  }

  drawPath(place, step, colors) {
    const { context, scene, sharp } = this;
    const last = scene.indexAt(step);
    const stroke = (from, to, color, width) => {
      context.beginPath();
      for (let index = from; index <= to; index++) context.lineTo(...place(scene.at(index)));
      context.strokeStyle = color;
      context.lineWidth = width * sharp;
      context.stroke();
    };
    stroke(Math.max(0, last), scene.path.step.length - 1, css(colors.path, 0.4), 1.2);
    stroke(0, last, css(colors.casing), 5);
    stroke(0, last, css(colors.path), 2.6);
    context.font = `bold ${16 * sharp}px system-ui, sans-serif`;
    for (const index of scene.path.collided) {
      if (index > last) continue;
      const [x, y] = place(scene.at(index));
      context.fillStyle = css(colors.bad);
      context.fillText("×", x - 5 * sharp, y + 6 * sharp);
    }
    if (last < 0) return;
    const from = place(scene.at(last));
    const corners = pyramid(scene, last, PYRAMID_M).map(place);
    context.strokeStyle = css(colors.vehicle);
    context.lineWidth = 2 * sharp;
    context.beginPath();
    corners.forEach((corner, side) => {
      context.moveTo(...from);
      context.lineTo(...corner);
      context.lineTo(...corners[(side + 1) % 4]);
    });
    context.stroke();
    context.beginPath();
    context.arc(...from, 5 * sharp, 0, 2 * Math.PI);
    context.fillStyle = css(colors.vehicle);
    context.fill();
    context.strokeStyle = css(colors.casing);
    context.stroke();
  }
}

// ---- the panel

class SpaceView {
  constructor() {
    this.canvas = at("space");
    this.step = 0;
    this.wanted = 0;
    this.pointers = new Map();
    this.share = 1; // of the pixels along either side, while it moves
    this.drawnAt = 0;
    this.settling = 0;
    this.visible = false;
    this.clear();
    const still = matchMedia("(prefers-reduced-motion: reduce)");
    this.moveMs = () => (still.matches ? 0 : MOVE_MS);
    at("space-views").addEventListener("click", ({ target }) => target.dataset.view && this.look(target.dataset.view));
    at("space-layers").addEventListener("click", ({ target }) => target.dataset.layer && this.toggle(target.dataset.layer));
    new ResizeObserver(() => this.redraw()).observe(at("space-view"));
    new IntersectionObserver(([{ isIntersecting }]) => {
      this.visible = isIntersecting;
      this.redraw();
    }, { rootMargin: "200px" }).observe(at("space-view"));
    dark.addEventListener("change", () => this.redraw());
    this.listen();
  }

  // Nothing to show, or nothing any more.
  clear() {
    Object.assign(this, { scene: null, orbit: null, layers: {}, preset: "oblique", moving: null });
    at("space-panel").hidden = true;
  }

  // A scene, or why there is none.
  take({ scene, problem }) {
    at("space-panel").hidden = false;
    at("space-note").textContent = problem ?? "";
    at("space-note").hidden = !problem;
    at("space-body").hidden = !scene;
    if (scene) this.open(scene);
  }

  // A scene, or what it has become.
  open(packed) {
    this.scene = new SceneData(packed);
    this.painter ??= this.painterFor();
    this.painter.open(this.scene);
    this.orbit ??= new Orbit();
    this.orbit.open(this.scene);
    if (this.preset && !this.following) this.orbit.take(this.orbit.preset(this.preset));
    const { truth, mapped } = this.has();
    if (!("path" in this.layers)) this.layers = { truth, mapped: mapped && !truth, path: true };
    for (const button of at("space-layers").children) button.hidden = { truth: !truth, mapped: !mapped, path: false }[button.dataset.layer];
    at("space-views").querySelector("[data-view=behind]").hidden = this.scene.path.step.length === 0;
    this.writeLegend();
    this.press();
    this.show(this.step);
  }

  has() {
    return { truth: Object.keys(this.scene.surfaces).length > 0, mapped: this.scene.voxels !== null };
  }

  painterFor() {
    const flat = new URLSearchParams(location.search).has("flat");
    try {
      if (flat) throw new Error("asked for");
      at("space-help").textContent = "Drag to turn, with the right button or Shift to move; two fingers zoom and move. After a click the wheel zooms, as does Ctrl and the wheel. Keys: arrows turn, with Shift move, + and − zoom, 0 shows all.";
      return new Solid(this.canvas, () => this.lose());
    } catch {
      // A canvas that was asked for WebGL gives no other context.
      const canvas = this.canvas.cloneNode();
      this.canvas.replaceWith(canvas);
      this.canvas = canvas;
      canvas.setAttribute("role", "img");
      canvas.removeAttribute("tabindex");
      canvas.removeAttribute("aria-roledescription");
      at("space-view").classList.add("flat");
      at("space-views").hidden = true;
      at("space-help").textContent = "This browser has no WebGL 2, or it is switched off: the scene is shown flat, from above and from the side.";
      return new Flat(canvas);
    }
  }

  // The graphics card may take its memory back; it tells when it has some again.
  lose() {
    this.painter = null;
    this.canvas.addEventListener("webglcontextrestored", () => {
      this.painter = this.painterFor();
      this.painter.open(this.scene);
      this.redraw();
    }, { once: true });
  }

  writeLegend() {
    const { truth } = this.has();
    const { legend, surfaces, path } = this.scene;
    const targets = surfaces.targets || this.scene.voxels?.target.includes(1);
    const shown = legend.filter((_, state) => (state === OTHER ? true : state === UNSEEN ? truth && surfaces.targets : targets));
    const keys = shown.map(({ name, color }) => {
      const swatch = element("span", { className: `swatch${color === legend[UNSEEN].color ? " striped" : ""}` });
      swatch.style.backgroundColor = css(color);
      return element("li", {}, swatch, name);
    });
    const line = (color, name) => {
      const swatch = element("span", { className: "swatch line" });
      swatch.style.backgroundColor = css(color);
      return element("li", {}, swatch, name);
    };
    const mark = element("span", { className: "swatch cross", textContent: "✕" });
    mark.style.color = css(THEMES.light.bad);
    const contacts = path.collided.length ? [element("li", {}, mark, "Contact")] : [];
    const squares = this.painter instanceof Solid ? `Squares on the ground are ${SQUARE_M} m wide. ` : "";
    const says = element("li", { className: "say", textContent: `${squares}Heights are not stretched. Colours are those of the step that is chosen below.` });
    at("space-legend").replaceChildren(...keys, line(THEMES.light.path, "Path, thin where it is still to come"), line(THEMES.light.vehicle, "Vehicle and what its camera takes in"), ...contacts, says);
  }

  show(step) {
    this.step = step;
    if (!this.scene) return;
    const counts = this.scene.counts(step).filter(({ all }) => all);
    const words = counts.map(({ name, all, seen, inspected }) => `${name}: ${inspected} of ${all} inspected, ${seen} seen`).join("; ");
    at("space-counts").textContent = words;
    this.canvas.setAttribute("aria-label", `${this.scene.title} in three dimensions at step ${step}${words ? `. ${words}` : ""}`);
    if (this.following) this.orbit.take(this.orbit.behind(this.scene, Math.max(0, this.scene.indexAt(step))));
    this.redraw();
  }

  toggle(layer) {
    this.layers[layer] = !this.layers[layer];
    this.press();
    this.redraw();
  }

  press() {
    for (const button of at("space-layers").children) button.setAttribute("aria-pressed", String(this.layers[button.dataset.layer]));
    for (const button of at("space-views").children) button.setAttribute("aria-pressed", String(button.dataset.view === this.preset));
  }

  get following() {
    return this.preset === "behind" && this.scene.path.step.length > 0;
  }

  // Go to a view, on the shorter way round.
  look(name) {
    this.preset = name;
    this.press();
    const goal = this.following ? this.orbit.behind(this.scene, Math.max(0, this.scene.indexAt(this.step))) : this.orbit.preset(name);
    const from = this.orbit.state;
    const turn = Math.atan2(Math.sin(goal.azimuth - from.azimuth), Math.cos(goal.azimuth - from.azimuth));
    const began = performance.now();
    const moving = (this.moving = {});
    const move = () => {
      if (this.moving !== moving) return;
      const share = this.moveMs() === 0 ? 1 : clamp((performance.now() - began) / this.moveMs(), 0, 1);
      const eased = share * share * (3 - 2 * share);
      const between = (a, b) => a + eased * (b - a);
      this.orbit.take({
        target: from.target.map((value, axis) => between(value, goal.target[axis])),
        distance: from.distance * (goal.distance / from.distance) ** eased,
        azimuth: from.azimuth + eased * turn,
        elevation: between(from.elevation, goal.elevation),
      });
      this.move();
      if (share < 1) requestAnimationFrame(move);
      else this.moving = null;
    };
    move();
  }

  // Whatever the reader does by hand ends a view that was chosen.
  byHand(change) {
    if (!this.orbit) return;
    this.moving = null;
    this.preset = null;
    change(this.orbit);
    this.press();
    this.move();
  }

  // While it moves a slow computer draws fewer pixels, and all of them once it stands still.
  move() {
    const pause = performance.now() - this.drawnAt;
    if (this.settling) this.share = clamp(this.share * (pause > SLOW_MS ? 0.8 : pause < SLOW_MS / 2 ? 1.1 : 1), 0.4, 1);
    clearTimeout(this.settling);
    this.settling = setTimeout(() => {
      this.settling = 0;
      if (this.share < 1) this.redraw();
      delete this.canvas.dataset.moving;
    }, SETTLED_MS);
    this.canvas.dataset.moving = "";
    this.redraw();
  }

  // Once a frame at most, and only where something changed.
  redraw() {
    this.wanted ||= requestAnimationFrame((now) => {
      this.wanted = 0;
      if (!this.scene || !this.painter || !this.visible) return;
      this.drawnAt = now;
      const aspect = this.painter.resize(this.settling ? this.share : 1);
      const reshaped = Math.abs(aspect - this.orbit.aspect) > 0.02;
      this.orbit.aspect = aspect;
      if (reshaped && this.preset && !this.following && !this.moving) this.orbit.take(this.orbit.preset(this.preset));
      this.painter.draw(this.orbit, this.step, this.layers);
      at("space-north").querySelector("g").style.transform = `rotate(${this.orbit.azimuth + Math.PI / 2}rad)`;
      this.canvas.dataset.drawn = String(Number(this.canvas.dataset.drawn ?? 0) + 1);
    });
  }

  // ---- mouse, fingers and keys

  listen() {
    const { canvas } = this;
    const middleOf = () => {
      const points = [...this.pointers.values()];
      const middle = [0, 1].map((axis) => points.reduce((sum, point) => sum + point[axis], 0) / points.length);
      return { middle, spread: points.length > 1 ? Math.hypot(points[0][0] - points[1][0], points[0][1] - points[1][1]) : 0 };
    };
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      canvas.focus({ preventScroll: true });
      this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!this.pointers.has(event.pointerId)) return;
      const before = middleOf();
      this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
      const after = middleOf();
      const height = canvas.clientHeight;
      const [right, down] = [0, 1].map((axis) => (after.middle[axis] - before.middle[axis]) / height);
      this.byHand((orbit) => {
        if (this.pointers.size > 1) {
          orbit.pan(right, -down);
          if (before.spread > 0 && after.spread > 0) orbit.zoom(before.spread / after.spread);
        } else if (event.buttons & 6 || event.shiftKey) orbit.pan(right, -down);
        else orbit.turn(-4 * right, 3 * down);
      });
    });
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, ({ pointerId }) => this.pointers.delete(pointerId));
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("wheel", (event) => {
      // A page that is scrolled past stays what it was.
      if (document.activeElement !== canvas && !event.ctrlKey) return;
      event.preventDefault();
      this.byHand((orbit) => orbit.zoom(Math.exp(clamp(event.deltaY * (event.deltaMode ? 30 : 1), -300, 300) / 500)));
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => {
      if (event.altKey || event.ctrlKey || event.metaKey || !this.orbit) return;
      const [right, up] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key] ?? [0, 0];
      if (right || up) this.byHand((orbit) => (event.shiftKey ? orbit.pan(-0.08 * right, -0.08 * up) : orbit.turn(0.15 * right, 0.12 * up)));
      else if ("+=".includes(event.key)) this.byHand((orbit) => orbit.zoom(0.85));
      else if ("-_".includes(event.key)) this.byHand((orbit) => orbit.zoom(1 / 0.85));
      else if (event.key === "0") this.look("oblique");
      else return;
      // These keys go through the steps elsewhere.
      event.preventDefault();
      event.stopPropagation();
    });
  }
}
