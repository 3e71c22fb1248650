// The viewer of a page that dynappo.play writes: everything is drawn here, nothing is fetched.
//
// 1 mathematics  2 the recording  3 shapes  4 WebGL: one light and its shadow  5 the page
//
// World: metres, z up. Quaternions are (w, x, y, z), matrices 4 x 4 by columns. Functions above
// "the page" are pure and are tested without a browser.
"use strict";

// ---- 1 mathematics

const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const scale = (a, s) => [a[0] * s, a[1] * s, a[2] * s];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) =>
  [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => scale(a, 1 / (Math.hypot(...a) || 1));
const clamp = (x, low, high) => Math.min(Math.max(x, low), high);
const mix = (a, b, s) => a + (b - a) * s;

function rotation(q) {
  const [w, x, y, z] = q;
  return [
    1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y),
    2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x),
    2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y),
  ];
}

const turn = (r, v) => [
  r[0] * v[0] + r[3] * v[1] + r[6] * v[2],
  r[1] * v[0] + r[4] * v[1] + r[7] * v[2],
  r[2] * v[0] + r[5] * v[1] + r[8] * v[2],
];

function matrix(position, r) {
  return [r[0], r[1], r[2], 0, r[3], r[4], r[5], 0, r[6], r[7], r[8], 0, ...position, 1];
}

function times(a, b) {
  const out = new Array(16);
  for (let c = 0; c < 4; c++)
    for (let r = 0; r < 4; r++) {
      let sum = 0;
      for (let k = 0; k < 4; k++) sum += a[4 * k + r] * b[4 * c + k];
      out[4 * c + r] = sum;
    }
  return out;
}

// a camera's matrix: world -> eye
function lookAt(eye, target, up) {
  const z = unit(sub(eye, target)), x = unit(cross(up, z)), y = cross(z, x);
  return [x[0], y[0], z[0], 0, x[1], y[1], z[1], 0, x[2], y[2], z[2], 0,
    -dot(x, eye), -dot(y, eye), -dot(z, eye), 1];
}

function perspective(fovy, aspect, near, far) {
  const f = 1 / Math.tan(fovy / 2);
  return [f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / (near - far), -1,
    0, 0, (2 * far * near) / (near - far), 0];
}

function orthographic(half, near, far) {
  return [1 / half, 0, 0, 0, 0, 1 / half, 0, 0, 0, 0, 2 / (near - far), 0,
    0, 0, (far + near) / (near - far), 1];
}

// ---- 2 the recording

function bytes(text) {
  const raw = atob(text), out = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) out[i] = raw.charCodeAt(i);
  return out.buffer;
}

// the scene with its arrays as numbers; see episode_page.py for what is in it
function decode(scene) {
  const numbers = { root: Float32Array, position: Int16Array, rotation: Int16Array,
    command: Float32Array, velocity: Float32Array };
  const out = { ...scene };
  for (const [name, kind] of Object.entries(numbers)) out[name] = new kind(bytes(scene[name]));
  out.meshes = scene.meshes.map((mesh) => mesh.heights ? field(mesh) : ({
    vertices: new Float32Array(bytes(mesh.vertices)),
    normals: new Float32Array(bytes(mesh.normals)),
    faces: new Uint32Array(bytes(mesh.faces)),
    face_normals: new Uint32Array(bytes(mesh.face_normals)),
  }));
  return out;
}

// a ground as a mesh: heights on a grid, two flat triangles a cell
function field(mesh) {
  const z = new Int16Array(bytes(mesh.heights)), { x, y } = mesh, nx = x.length, ny = y.length;
  const vertices = [], normals = [], faces = [], face_normals = [];
  for (let j = 0; j < ny; j++)
    for (let i = 0; i < nx; i++)
      vertices.push(x[i], y[j], z[j * nx + i] * mesh.unit);
  const side = (from, to) => [0, 1, 2].map((k) => vertices[3 * to + k] - vertices[3 * from + k]);
  for (let j = 0; j + 1 < ny; j++)
    for (let i = 0; i + 1 < nx; i++) {
      const a = j * nx + i, c = a + nx + 1;
      for (const [b, d] of [[a + 1, c], [c, a + nx]]) {
        const [u, v] = [side(a, b), side(a, d)], n = normals.length / 3;
        normals.push(...unit([u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2],
          u[0] * v[1] - u[1] * v[0]]));
        faces.push(a, b, d);
        face_normals.push(n, n, n);
      }
    }
  return { vertices, normals, faces, face_normals };
}

// [{position, quat}] of every body at `row`, which may lie between two rows
function pose(scene, row) {
  const first = clamp(Math.floor(row), 0, scene.rows - 1), s = clamp(row - first, 0, 1);
  const second = Math.min(first + 1, scene.rows - 1), B = scene.bodies, out = [];
  for (let b = 0; b < B; b++) {
    const i = first * B + b, j = second * B + b, position = [], quat = [];
    for (let k = 0; k < 3; k++) {
      const one = scene.root[3 * first + k] + scene.position[3 * i + k] * scene.unit;
      const other = scene.root[3 * second + k] + scene.position[3 * j + k] * scene.unit;
      position.push(mix(one, other, s));
    }
    let sign = 0;
    for (let k = 0; k < 4; k++) sign += scene.rotation[4 * i + k] * scene.rotation[4 * j + k];
    for (let k = 0; k < 4; k++) {
      const other = scene.rotation[4 * j + k] * (sign < 0 ? -1 : 1);
      quat.push(mix(scene.rotation[4 * i + k], other, s));
    }
    const size = Math.hypot(...quat) || 1;
    out.push({ position, quat: quat.map((x) => x / size) });
  }
  return out;
}

// command, or velocity, at `row`: vx, vy in m/s and the yaw rate in rad/s
const motion = (values, row, rows) => {
  const i = 3 * clamp(Math.floor(row), 0, rows - 1);
  return [values[i], values[i + 1], values[i + 2]];
};

// ---- 3 shapes: {points, normals, faces}, flat arrays

function lathe(profile, around) {
  // profile: [radius, z, normal's radius, normal's z] from bottom to top, about the z axis
  const points = [], normals = [], faces = [];
  profile.forEach(([r, z, nr, nz]) => {
    for (let i = 0; i <= around; i++) {
      const c = Math.cos((2 * Math.PI * i) / around), s = Math.sin((2 * Math.PI * i) / around);
      points.push(r * c, r * s, z);
      normals.push(nr * c, nr * s, nz);
    }
  });
  for (let j = 0; j + 1 < profile.length; j++)
    for (let i = 0; i < around; i++) {
      const a = j * (around + 1) + i, b = a + around + 1;
      faces.push(a, a + 1, b + 1, a, b + 1, b);
    }
  return { points, normals, faces };
}

function arc(from, to, steps, radius, r, z) {
  const out = [];
  for (let i = 0; i <= steps; i++) {
    const a = mix(from, to, i / steps), c = Math.cos(a), s = Math.sin(a);
    out.push([r + radius * c, z + radius * s, c, s]);
  }
  return out;
}

const QUARTER = Math.PI / 2;

function sphere(radius, detail) {
  return lathe(arc(-QUARTER, QUARTER, detail, radius, 0, 0), 2 * detail);
}

function ellipsoid(size, detail) {
  const ball = sphere(1, detail), { points, normals } = ball;
  for (let i = 0; i < points.length; i += 3) {
    const n = unit([points[i] / size[0], points[i + 1] / size[1], points[i + 2] / size[2]]);
    for (let k = 0; k < 3; k++) {
      points[i + k] *= size[k];
      normals[i + k] = n[k];
    }
  }
  return ball;
}

function capsule(radius, half, detail) {
  const steps = Math.max(2, detail >> 1);
  return lathe([...arc(-QUARTER, 0, steps, radius, 0, -half),
    ...arc(0, QUARTER, steps, radius, 0, half)], 2 * detail);
}

function cylinder(radius, half, detail) {
  return lathe([[0, -half, 0, -1], [radius, -half, 0, -1], [radius, -half, 1, 0],
    [radius, half, 1, 0], [radius, half, 0, 1], [0, half, 0, 1]], 2 * detail);
}

function box(size) {
  const points = [], normals = [], faces = [];
  for (let axis = 0; axis < 3; axis++)
    for (const side of [-1, 1]) {
      const u = (axis + 1) % 3, v = (axis + 2) % 3, a = points.length / 3;
      for (const [i, j] of [[-1, -1], [1, -1], [1, 1], [-1, 1]]) {
        const p = [0, 0, 0], n = [0, 0, 0];
        [p[axis], p[u], p[v], n[axis]] = [side * size[axis], i * size[u], j * size[v], side];
        points.push(...p);
        normals.push(...n);
      }
      faces.push(...(side > 0 ? [a, a + 1, a + 2, a, a + 2, a + 3] : [a, a + 2, a + 1, a, a + 3, a + 2]));
    }
  return { points, normals, faces };
}

function imported(mesh) {
  const points = [], normals = [], faces = [];
  for (let i = 0; i < mesh.faces.length; i++) {
    const v = 3 * mesh.faces[i], n = 3 * mesh.face_normals[i];
    points.push(mesh.vertices[v], mesh.vertices[v + 1], mesh.vertices[v + 2]);
    normals.push(mesh.normals[n], mesh.normals[n + 1], mesh.normals[n + 2]);
    faces.push(i);
  }
  return { points, normals, faces };
}

// half the segments of a circle of this radius: flat parts lie less than 0.25 mm inside it
const segments = (radius, most) =>
  Math.ceil(clamp(Math.PI / (2 * Math.acos(1 - Math.min(2.5e-4 / radius, 0.5))), 4, most));

// the shape of a geom in its own frame; a circle has at most 2 x `most` segments
function shape(geom, meshes, most) {
  const [a, b] = geom.size;
  const detail = segments(geom.type === "ellipsoid" ? Math.max(...geom.size) : a, most);
  if (geom.type === "sphere") return sphere(a, detail);
  if (geom.type === "ellipsoid") return ellipsoid(geom.size, detail);
  if (geom.type === "capsule") return capsule(a, b, detail);
  if (geom.type === "cylinder") return cylinder(a, b, detail);
  if (geom.type === "mesh") return imported(meshes[geom.mesh]);
  return box(geom.size);
}

// all shapes that move with `body`, in its frame, with a colour and a finish for every vertex
function merge(scene, body, wanted, most) {
  const out = { points: [], normals: [], colors: [], finish: [], faces: [] };
  for (const geom of scene.geoms) {
    if (geom.body !== body || !wanted(geom)) continue;
    const { points, normals, faces } = shape(geom, scene.meshes, most);
    const r = rotation(geom.quat), first = out.points.length / 3;
    for (let i = 0; i < points.length; i += 3) {
      out.points.push(...add(turn(r, points.slice(i, i + 3)), geom.pos));
      out.normals.push(...turn(r, normals.slice(i, i + 3)));
      out.colors.push(...geom.color);
      out.finish.push(geom.specular, geom.shininess, geom.emission);
    }
    for (const f of faces) out.faces.push(first + f);
  }
  return out;
}

// a bent arrow that lies flat: `angle` rad about the z axis, from straight ahead
function bend(angle, radius, thickness, detail) {
  const points = [], normals = [], faces = [], around = 10, length = Math.abs(angle);
  const sign = Math.sign(angle) || 1, head = Math.min(0.22, 0.6 * length);
  const rings = [];
  const steps = Math.max(3, Math.ceil(detail * length));
  for (let i = 0; i <= steps; i++) rings.push([mix(0, length - head, i / steps), thickness, 0]);
  rings.unshift([0, 0, -1]);
  rings.push([length - head, 2.2 * thickness, -0.3], [length, 0, 0.35]);
  for (const [a, r, lean] of rings) {
    const c = Math.cos(sign * a), s = Math.sin(sign * a), along = [-s * sign, c * sign, 0];
    for (let i = 0; i <= around; i++) {
      const u = Math.cos((2 * Math.PI * i) / around), v = Math.sin((2 * Math.PI * i) / around);
      points.push((radius + r * u) * c, (radius + r * u) * s, r * v);
      normals.push(...unit(add([u * c, u * s, v], scale(along, lean))));
    }
  }
  for (let j = 0; j + 1 < rings.length; j++)
    for (let i = 0; i < around; i++) {
      const a = j * (around + 1) + i, b = a + around + 1;
      faces.push(...(sign < 0 ? [a, a + 1, b + 1, a, b + 1, b] : [a, b + 1, a + 1, a, b, b + 1]));
    }
  return { points, normals, faces };
}

// a straight arrow along x
function straight(length, thickness, around) {
  const head = Math.min(4.5 * thickness, 0.6 * length), neck = length - head;
  const turned = lathe([[0, 0, 0, -1], [thickness, 0, 0, -1], [thickness, 0, 1, 0],
    [thickness, neck, 1, 0], [thickness, neck, 0, -1], [2.2 * thickness, neck, 0, -1],
    [2.2 * thickness, neck, 0.87, 0.49], [0, length, 0.87, 0.49]], around);
  for (const list of [turned.points, turned.normals])
    for (let i = 0; i < list.length; i += 3)
      [list[i], list[i + 1], list[i + 2]] = [list[i + 2], list[i], list[i + 1]];
  return turned;
}

const COLORS = { command: [0.1, 0.62, 0.3], velocity: [0.13, 0.42, 0.93], fall: [0.85, 0.25, 0.2] };

// arrows above the robot for vx, vy and on the floor about it for the yaw rate, in world coordinates
function arrows(scene, bodies, command, velocity) {
  const out = [], base = bodies[scene.base], size = scene.radius;
  const x = turn(rotation(base.quat), [1, 0, 0]), yaw = Math.atan2(x[1], x[0]);
  const place = (mesh, angle, at, color) => {
    const r = rotation([Math.cos(angle / 2), 0, 0, Math.sin(angle / 2)]), points = [], normals = [];
    for (let i = 0; i < mesh.points.length; i += 3) {
      points.push(...add(turn(r, mesh.points.slice(i, i + 3)), at));
      normals.push(...turn(r, mesh.normals.slice(i, i + 3)));
    }
    out.push({ points, normals, faces: mesh.faces, color });
  };
  const pairs = [[command, COLORS.command, 0], [velocity, COLORS.velocity, 1]];
  for (const [v, color, k] of scene.asked ? pairs : pairs.slice(1)) {
    const speed = Math.hypot(v[0], v[1]);
    const at = add(base.position, [0, 0, Math.max(0.3 * size, scene.top) + 0.085 * size * k]);
    if (speed > 0.05)
      place(straight(0.75 * size * speed, 0.02 * size, 20), yaw + Math.atan2(v[1], v[0]), at, color);
    const floor = [base.position[0], base.position[1], scene.floor + 0.02 * size];
    if (Math.abs(v[2]) > 0.1)
      place(bend(clamp(v[2], -3, 3), size * (1.12 + 0.1 * k), 0.016 * size, 24), yaw, floor, color);
  }
  return out;
}

// where the robot walked until `row`: [x, y] points on the floor
function trail(scene, row) {
  const out = [];
  for (let i = 0; i <= Math.min(row, scene.rows - 1); i++)
    out.push([scene.root[3 * i], scene.root[3 * i + 1]]);
  return out;
}

// orbit camera -> {eye, view, projection}
function shoot(camera, aspect) {
  const c = Math.cos(camera.elevation);
  // the angle is that of the shorter side, so that the robot fits a telephone held upright
  const fovy = 2 * Math.atan(Math.tan(camera.fovy / 2) * Math.max(1, 1.2 / aspect));
  const out = [c * Math.cos(camera.azimuth), c * Math.sin(camera.azimuth), Math.sin(camera.elevation)];
  const eye = add(camera.target, scale(out, camera.distance));
  return { eye, view: lookAt(eye, camera.target, [0, 0, 1]),
    projection: perspective(fovy, aspect, 0.02 * camera.distance, 60 + camera.distance) };
}

// ---- 4 WebGL: one light and its shadow

const SUN = unit([0.42, -0.52, 0.86]);  // towards it; close to the light of the robots' MJCF
const SHADOW = 2048;  // texels of a side
const AIR = [0.87, 0.905, 0.937];  // what is far away has this colour, as the page behind it

const LIGHT = `#version 300 es
precision highp float;
precision highp sampler2DShadow;
uniform vec3 eye, sun, air;
uniform float size;  // m, of the robot
uniform mat4 sunView;
uniform sampler2DShadow shadow;
out vec4 pixel;
float sunlight(vec3 p) {  // share of the sun that reaches p
  vec3 c = (sunView * vec4(p, 1.0)).xyz * 0.5 + 0.5;
  if (any(lessThan(c, vec3(0.0))) || any(greaterThan(c, vec3(1.0)))) return 1.0;
  float light = 0.0;
  for (int i = 0; i < 9; i++)
    light += texture(shadow, vec3(c.xy + vec2(i % 3 - 1, i / 3 - 1) * 0.0007, c.z - 0.0015));
  return light / 9.0;
}
vec3 haze(vec3 c, vec3 p) {
  return mix(c, air, 1.0 - exp(-pow(length(p - eye) / (28.0 * size), 2.2)));
}
`;
const SURFACE_VERTEX = `#version 300 es
in vec3 point, normal, color, finish;
uniform mat4 model, camera;
out vec3 p, n, albedo, coat;
void main() {
  vec4 world = model * vec4(point, 1.0);
  p = world.xyz; n = mat3(model) * normal; albedo = color; coat = finish;
  gl_Position = camera * world;
}`;
const SURFACE = LIGHT + `
in vec3 p, n, albedo, coat;  // coat: specular, shininess, emission of the MJCF
uniform float shaded;
void main() {
  vec3 normal = normalize(n), halfway = normalize(sun + normalize(eye - p));
  float light = max(dot(normal, sun), 0.0);
  if (shaded > 0.5) light *= sunlight(p + normal * 0.014 * size);
  float glint = 0.5 * coat.x * pow(max(dot(normal, halfway), 0.0), 1.0 + 128.0 * coat.y) * light;
  vec3 ambient = mix(vec3(0.48, 0.48, 0.49), vec3(0.80, 0.82, 0.85), 0.5 + 0.5 * normal.z);
  pixel = vec4(haze(albedo * (ambient + 0.5 * light + coat.z) + glint, p), 1.0);
}`;
const FLOOR_VERTEX = `#version 300 es
in vec3 point;
uniform mat4 camera;
uniform vec3 center;
uniform float size, ground;
out vec3 p;
void main() {
  p = vec3(center.xy + point.xy * 90.0 * size, ground);
  gl_Position = camera * vec4(p, 1.0);
}`;
const FLOOR = LIGHT + `
in vec3 p;
uniform float tile;
// checkerboard, filtered with a box as wide as the pixel (the integral of a square wave, squared)
float checker(vec2 x, vec2 w) {
  vec2 i = 2.0 * (abs(fract((x - 0.5 * w) * 0.5) - 0.5) - abs(fract((x + 0.5 * w) * 0.5) - 0.5)) / w;
  return 0.5 - 0.5 * i.x * i.y;
}
void main() {
  vec2 x = p.xy / tile, w = max(fwidth(x), vec2(1e-4));
  vec3 c = mix(vec3(0.775, 0.785, 0.80), vec3(0.83, 0.84, 0.85), checker(x, w));
  pixel = vec4(haze(c * (0.68 + 0.32 * sunlight(p)), p), 1.0);
}`;
const DEPTH_VERTEX = `#version 300 es
in vec3 point;
uniform mat4 model, camera;
void main() { gl_Position = camera * model * vec4(point, 1.0); }`;
const DEPTH = `#version 300 es
precision highp float;
void main() {}`;
const TRAIL_VERTEX = `#version 300 es
in vec3 point;
in float age;
uniform mat4 camera;
out float seen;
void main() { seen = age; gl_Position = camera * vec4(point, 1.0); }`;
const TRAIL = `#version 300 es
precision highp float;
in float seen;
out vec4 pixel;
void main() { pixel = vec4(0.13, 0.42, 0.93, 0.55 * seen); }`;

const ATTRIBUTES = ["point", "normal", "color", "finish", "age"];

function link(gl, vertex, fragment) {
  const program = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost())
      throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(program, shader);
  }
  ATTRIBUTES.forEach((name, i) => gl.bindAttribLocation(program, i, name));
  gl.linkProgram(program);
  const uniforms = {}, count = gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS);
  for (let i = 0; i < count; i++) {
    const { name, type } = gl.getActiveUniform(program, i);
    uniforms[name] = { at: gl.getUniformLocation(program, name), type };
  }
  return { program, uniforms };
}

// a mesh on the graphics card; values of ATTRIBUTES that it lacks are constants of the draw call
function upload(gl, mesh, usage) {
  const vao = gl.createVertexArray(), buffers = [];
  gl.bindVertexArray(vao);
  const lists = { point: mesh.points, normal: mesh.normals, color: mesh.colors, finish: mesh.finish,
    age: mesh.ages };
  ATTRIBUTES.forEach((name, i) => {
    if (!lists[name]) return;
    const buffer = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(lists[name]), usage || gl.STATIC_DRAW);
    gl.enableVertexAttribArray(i);
    gl.vertexAttribPointer(i, name === "age" ? 1 : 3, gl.FLOAT, false, 0, 0);
    buffers.push(buffer);
  });
  const index = gl.createBuffer();
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, index);
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, new Uint32Array(mesh.faces), usage || gl.STATIC_DRAW);
  gl.bindVertexArray(null);
  return { vao, count: mesh.faces.length, free() {
    [...buffers, index].forEach((b) => gl.deleteBuffer(b));
    gl.deleteVertexArray(vao);
  } };
}

// the depth texture of the shadow, to draw into and to compare with
function shadowMap(gl) {
  const target = gl.createFramebuffer();
  gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
  gl.texStorage2D(gl.TEXTURE_2D, 1, gl.DEPTH_COMPONENT24, SHADOW, SHADOW);
  for (const [name, value] of [
    [gl.TEXTURE_MIN_FILTER, gl.LINEAR], [gl.TEXTURE_MAG_FILTER, gl.LINEAR],
    [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE],
    [gl.TEXTURE_COMPARE_MODE, gl.COMPARE_REF_TO_TEXTURE], [gl.TEXTURE_COMPARE_FUNC, gl.LEQUAL],
  ]) gl.texParameteri(gl.TEXTURE_2D, name, value);
  const texture = gl.getParameter(gl.TEXTURE_BINDING_2D);
  gl.bindFramebuffer(gl.FRAMEBUFFER, target);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, texture, 0);
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  return target;
}

// the camera of the shadow, about `center`: world -> its texture
function fromSun(scene, center) {
  const half = 2.6 * scene.radius, texel = (2 * half) / SHADOW, view = lookAt(SUN, [0, 0, 0], [0, 0, 1]);
  // moved by whole texels only, else the edges of shadows crawl
  for (let k = 0; k < 3; k++) {
    const at = view[k] * center[0] + view[4 + k] * center[1] + view[8 + k] * center[2];
    view[12 + k] = k < 2 ? -Math.round(at / texel) * texel : -at - 2 * half;
  }
  return times(orthographic(half, 0, 4 * half), view);
}

// draw(state) for WebGL 2, or null where the browser has none
function webgl(canvas, scene) {
  const gl = canvas.getContext("webgl2", { antialias: true, alpha: false, powerPreference: "high-performance" });
  if (!gl) return null;
  const surface = link(gl, SURFACE_VERTEX, SURFACE), floor = link(gl, FLOOR_VERTEX, FLOOR);
  const depth = link(gl, DEPTH_VERTEX, DEPTH), line = link(gl, TRAIL_VERTEX, TRAIL);
  const square = upload(gl, { points: [-1, -1, 0, 1, -1, 0, 1, 1, 0, -1, 1, 0], faces: [0, 1, 2, 0, 2, 3] });
  const kinds = { looks: (g) => g.group < 3, contacts: (g) => g.group >= 3 || g.body < 0 };
  const meshes = {};
  for (const [kind, wanted] of Object.entries(kinds)) {
    meshes[kind] = [];
    for (let body = -1; body < scene.bodies; body++) {
      const mesh = merge(scene, body, wanted, 20);
      if (mesh.faces.length) meshes[kind].push({ body, ...upload(gl, mesh) });
    }
  }
  const shadow = shadowMap(gl), whole = matrix([0, 0, 0], rotation([1, 0, 0, 0]));

  function use({ program, uniforms }, values) {
    gl.useProgram(program);
    for (const [name, value] of Object.entries(values)) {
      const u = uniforms[name];
      if (!u) continue;
      if (u.type === gl.FLOAT_MAT4) gl.uniformMatrix4fv(u.at, false, value);
      else if (u.type === gl.FLOAT_VEC3) gl.uniform3fv(u.at, value);
      else if (u.type === gl.FLOAT) gl.uniform1f(u.at, value);
      else gl.uniform1i(u.at, value);
    }
  }
  function draw(mesh) {
    gl.bindVertexArray(mesh.vao);
    gl.drawElements(gl.TRIANGLES, mesh.count, gl.UNSIGNED_INT, 0);
  }
  function robot(program, kind, models) {
    for (const mesh of meshes[kind]) {
      use(program, { model: mesh.body < 0 ? whole : models[mesh.body] });
      draw(mesh);
    }
  }
  function once(mesh) {
    const on = upload(gl, mesh, gl.STREAM_DRAW);
    draw(on);
    on.free();
  }

  return function render(state) {
    const { camera, bodies, kind } = state, width = canvas.width, height = canvas.height;
    const { eye, view, projection } = shoot(camera, width / height);
    const matrices = bodies.map((b) => matrix(b.position, rotation(b.quat)));
    const base = bodies[scene.base].position, center = [base[0], base[1], scene.floor + 0.3 * scene.radius];
    const world = { eye, center, sun: SUN, air: AIR, size: scene.radius, ground: scene.floor, tile: scene.tile,
      sunView: fromSun(scene, center), camera: times(projection, view), shaded: 1, shadow: 0 };
    gl.enable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
    gl.bindFramebuffer(gl.FRAMEBUFFER, shadow);
    gl.viewport(0, 0, SHADOW, SHADOW);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    use(depth, { camera: world.sunView });
    robot(depth, kind, matrices);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, width, height);
    gl.clearColor(...AIR, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    use(floor, world);
    draw(square);
    use(surface, world);
    robot(surface, kind, matrices);
    use(surface, { model: whole, shaded: 0 });
    for (const arrow of arrows(scene, bodies, state.command, state.velocity)) {
      gl.vertexAttrib3fv(2, arrow.color);
      gl.vertexAttrib3fv(3, [0, 0, 0.3]);
      once(arrow);
    }
    const path = ribbon(trail(scene, state.row), 0.008 * scene.radius, scene.floor + 0.002 * scene.radius);
    if (!path) return;
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    use(line, world);
    once(path);
  };
}

// a flat band of half width `half` at height z along [x, y] points; older parts fade
function ribbon(points, half, z) {
  const out = { points: [], ages: [], faces: [] }, n = points.length;
  for (let i = 0; i < n; i++) {
    const one = points[Math.max(i - 1, 0)], other = points[Math.min(i + 1, n - 1)];
    const d = [other[0] - one[0], other[1] - one[1]], size = Math.hypot(...d) || 1;
    const side = [(-d[1] / size) * half, (d[0] / size) * half];
    out.points.push(points[i][0] + side[0], points[i][1] + side[1], z);
    out.points.push(points[i][0] - side[0], points[i][1] - side[1], z);
    out.ages.push((i + 1) / n, (i + 1) / n);
    if (i) out.faces.push(2 * i - 2, 2 * i - 1, 2 * i + 1, 2 * i - 2, 2 * i + 1, 2 * i);
  }
  return n > 1 ? out : null;
}

// ---- 5 the page

const SHARP = [1, 0.75, 0.5];  // pixels a screen pixel: a machine that cannot keep up draws fewer
const SPEEDS = [0.1, 0.25, 0.5, 1, 2];
const signed = (x) => (x < 0 ? "\u2212" : "+") + Math.abs(x).toFixed(2);

// the three lines over time: what was asked (green) and what came (blue); `row` is the present
function chart(pen, scene, w, h, row) {
  const lane = h / 3;
  pen.clearRect(0, 0, w, h);
  const x = (i) => (w * i) / Math.max(1, scene.rows - 1);
  for (let k = 0; k < 3; k++) {
    let top = 0.5;
    for (let i = k; i < 3 * scene.rows; i += 3)
      top = Math.max(top, Math.abs(scene.command[i]), Math.abs(scene.velocity[i]));
    top = Math.min(top, 3);
    const y = (v) => lane * (k + 0.5) - (clamp(v, -top, top) / top) * lane * 0.42;
    pen.fillStyle = "rgba(20,30,45,0.10)";
    pen.fillRect(0, Math.round(y(0)), w, 1);
    const lines = [[scene.command, COLORS.command, 3, 0.5], [scene.velocity, COLORS.velocity, 1.4, 1]];
    for (const [values, color, width, strong] of scene.asked ? lines : lines.slice(1)) {
      for (const [from, to, alpha] of [[0, scene.rows - 1, 0.3 * strong], [0, row, strong]]) {
        pen.beginPath();
        for (let i = from; i <= to; i++) pen.lineTo(x(i), y(values[3 * i + k]));
        pen.strokeStyle = `rgba(${color.map((c) => Math.round(255 * c)).join(",")},${alpha})`;
        pen.lineWidth = width;
        pen.stroke();
      }
    }
  }
  if (scene.fall !== null) {
    pen.fillStyle = "rgba(210,60,50,0.8)";
    pen.fillRect(x(scene.fall / scene.dt), 0, 1.5, h);
  }
  pen.fillStyle = "#16202e";
  pen.fillRect(x(row) - 0.75, 0, 1.5, h);
}

function main() {
  const $ = (id) => document.getElementById(id);
  let scene = decode(JSON.parse($("scene").textContent)), last = scene.rows - 1;
  const canvas = $("stage"), render = webgl(canvas, scene) || (() => {});
  $("note").hidden = canvas.getContext("webgl2") !== null;
  const home = { azimuth: -0.66, elevation: scene.elevation, distance: 4.6 * scene.radius };
  const camera = { ...home, fovy: 0.55, target: [0, 0, 0] };
  const state = { row: 0, playing: true, speed: 1, follow: true, kind: "looks", level: 0, held: 0 };
  const start = /[#&]t=([\d.]+)/.exec(location.hash);  // page.html#t=2.5 shows that moment; also #contacts
  if (start) Object.assign(state, { row: clamp(Math.round(start[1] / scene.dt) - 1, 0, last), playing: false });
  const aim = (row) => {
    const p = pose(scene, row)[scene.base].position;
    return [p[0], p[1], mix(scene.floor, p[2], 0.55)];
  };
  camera.target = aim(state.row);

  function seek(row) {
    state.row = clamp(row, 0, last);
    if (state.follow) camera.target = aim(state.row);
  }
  function play(on) {
    if (on && state.row >= last) seek(0);
    state.playing = on;
    $("play").classList.toggle("on", on);
    $("play").setAttribute("aria-label", on ? "pause" : "play");
  }
  function toggle(name, on) {
    if (name === "follow") state.follow = on;
    else state.kind = on ? "contacts" : "looks";
    $(name).setAttribute("aria-pressed", on);
    if (name === "follow" && on) camera.target = aim(state.row);
  }
  function speed(value) {
    state.speed = value;
    $("speed").textContent = `${value}\u00d7`;
  }
  const faster = (step) =>
    speed(SPEEDS[clamp(SPEEDS.indexOf(state.speed) + step, 0, SPEEDS.length - 1)]);

  $("play").onclick = () => play(!state.playing);
  $("follow").onclick = () => toggle("follow", !state.follow);
  $("contacts").onclick = () => toggle("contacts", state.kind === "looks");
  $("speed").onclick = () => speed(SPEEDS[(SPEEDS.indexOf(state.speed) + 1) % SPEEDS.length]);
  $("home").onclick = () => Object.assign(camera, home, { target: aim(state.row) });
  play(state.playing);
  const plain = !scene.geoms.some((g) => g.body >= 0 && g.group < 3);  // contact shapes only
  if (plain || /[#&]contacts/.test(location.hash)) toggle("contacts", true);
  addEventListener("keydown", (event) => {
    const keys = {
      " ": () => play(!state.playing),
      ArrowLeft: () => (play(false), seek(Math.ceil(state.row) - (event.shiftKey ? 1 / scene.dt : 1))),
      ArrowRight: () => (play(false), seek(Math.floor(state.row) + (event.shiftKey ? 1 / scene.dt : 1))),
      Home: () => seek(0),
      "+": () => faster(1), "=": () => faster(1), "-": () => faster(-1),
      f: () => $("follow").click(), c: () => $("contacts").click(), r: () => $("home").click(),
    };
    const act = !event.ctrlKey && !event.metaKey && !event.altKey && keys[event.key];
    if (!act) return;
    event.preventDefault();
    if (document.activeElement) document.activeElement.blur();
    act();
  });
  addEventListener("message", ({ data, source }) => {  // a report shows another recording of this robot
    if (source !== parent || !data.scene) return;
    scene = decode(data.scene);
    last = scene.rows - 1;
    $("subtitle").textContent = data.subtitle;
    const texts = data.measures.map((row) => {  // as texts: whoever has this page in a frame may send them
      const line = document.createElement("tr");
      for (const text of row) line.appendChild(document.createElement("td")).textContent = text;
      return line;
    });
    $("measures").tBodies[0].replaceChildren(...texts);
    $("seconds").textContent = (scene.rows * scene.dt).toFixed(1);
    state.held = 0;
    shown = "";
    seek(0);
    play(true);
  });
  drag(canvas, camera, (moved) => moved && toggle("follow", false));
  scrub($("chart"), (share) => (play(false), seek(share * last)));

  let before = performance.now(), late = -4;  // the first pictures take longer
  let shown = "";  // what the last picture showed: a page at rest draws nothing
  document.addEventListener("visibilitychange", () => {  // a hidden page draws nothing: not slow
    before = performance.now();
    late = -4;
  });
  function frame(now) {
    const took = Math.max(0, now - before) / 1000, passed = Math.min(0.25, took);
    before = now;
    if (state.playing) {
      state.row += (passed * state.speed) / scene.dt;
      if (state.row >= last) {  // rest on the last picture, then begin again
        state.row = last;
        state.held += passed;
        if (state.held > 1) seek((state.held = 0));
      }
    }
    late = took > 0.05 ? late + 1 + Math.floor(took / 0.2) : 0;
    if (late > 4 && state.level < SHARP.length - 1) [state.level, late] = [state.level + 1, 0];
    if (state.follow) {
      const goal = aim(state.row), pull = state.playing ? 1 - Math.exp(-passed * 12) : 1;
      camera.target = camera.target.map((x, k) => mix(x, goal[k], pull));
    }
    const sizes = [canvas, $("chart")].map((part) => [part.clientWidth, part.clientHeight]);
    const next = JSON.stringify([state, camera, sizes, devicePixelRatio]);
    if (next !== shown) show();
    shown = next;
    requestAnimationFrame(frame);
  }
  function show() {
    const ratio = Math.min(devicePixelRatio || 1, 2) * SHARP[state.level];
    const w = Math.max(1, Math.round(canvas.clientWidth * ratio)), h = Math.max(1, Math.round(canvas.clientHeight * ratio));
    if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
    const command = motion(scene.command, state.row, scene.rows);
    const velocity = motion(scene.velocity, state.row, scene.rows);
    render({ ...state, camera, command, velocity, bodies: pose(scene, state.row) });
    document.body.classList.toggle("unasked", !scene.asked);
    const ids = ["vx", "vy", "wz"];
    ids.forEach((id, k) => {
      $(`${id}-command`).textContent = signed(command[k]);
      $(`${id}-velocity`).textContent = signed(velocity[k]);
    });
    const t = (Math.floor(state.row) + 1) * scene.dt;
    $("time").textContent = `${t.toFixed(2)} s`;
    $("fell").hidden = scene.fall === null || t < scene.fall;
    const graph = $("chart"), size = devicePixelRatio || 1;
    const gw = Math.round(graph.clientWidth * size), gh = Math.round(graph.clientHeight * size);
    if (graph.width !== gw || graph.height !== gh) [graph.width, graph.height] = [gw, gh];
    const pen = graph.getContext("2d");
    pen.setTransform(size, 0, 0, size, 0, 0);
    if (gw && gh) chart(pen, scene, graph.clientWidth, graph.clientHeight, state.row);
  }
  requestAnimationFrame(frame);
}

// one finger or the left button turns, two fingers or the right button moves, wheel and pinch zoom
function drag(canvas, camera, changed) {
  const down = new Map();
  canvas.oncontextmenu = (event) => event.preventDefault();
  canvas.onpointerdown = (event) => {
    canvas.setPointerCapture(event.pointerId);
    down.set(event.pointerId, event);
  };
  canvas.onpointerup = canvas.onpointercancel = (event) => down.delete(event.pointerId);
  const zoom = (factor) => (camera.distance = clamp(camera.distance * factor, 0.4, 40));
  const move = (dx, dy) => {
    const s = (camera.distance * Math.tan(camera.fovy / 2) * 2) / canvas.clientHeight;
    const right = [-Math.sin(camera.azimuth), Math.cos(camera.azimuth), 0];
    const ahead = [-Math.cos(camera.azimuth), -Math.sin(camera.azimuth), 0];
    camera.target = add(camera.target, add(scale(right, -dx * s), scale(ahead, dy * s)));
    changed(true);
  };
  canvas.onpointermove = (event) => {
    const old = down.get(event.pointerId);
    if (!old) return;
    const dx = event.clientX - old.clientX, dy = event.clientY - old.clientY;
    if (down.size > 1) {
      const [a, b] = [...down.values()], other = a.pointerId === event.pointerId ? b : a;
      const gap = (e) => Math.hypot(e.clientX - other.clientX, e.clientY - other.clientY) || 1;
      zoom(gap(old) / gap(event));
      move(dx / 2, dy / 2);
    } else if (event.buttons & 2 || event.shiftKey) move(dx, dy);
    else {
      camera.azimuth -= dx * 0.008;
      camera.elevation = clamp(camera.elevation + dy * 0.006, 0.02, 1.5);
    }
    down.set(event.pointerId, event);
  };
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(event.deltaY * 0.001));
  }, { passive: false });
}

function scrub(graph, seek) {
  const at = (event) => {
    const area = graph.getBoundingClientRect();
    seek(clamp((event.clientX - area.left) / area.width, 0, 1));
  };
  graph.onpointerdown = (event) => {
    graph.setPointerCapture(event.pointerId);
    at(event);
  };
  graph.onpointermove = (event) => event.buttons && at(event);
}

if (typeof document !== "undefined") main();
