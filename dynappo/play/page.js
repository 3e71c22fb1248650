// The viewer of a page that dynappo.play writes: everything is drawn here, nothing is fetched.
//
// 1 mathematics  2 the recording  3 shapes  4 WebGL  5 canvas, where there is no WebGL  6 the page
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

// the scene with its arrays as numbers; see page.py for what is in it
function decode(scene) {
  const numbers = { root: Float32Array, position: Int16Array, rotation: Int16Array,
    command: Float32Array, velocity: Float32Array };
  const out = { ...scene };
  for (const [name, kind] of Object.entries(numbers)) out[name] = new kind(bytes(scene[name]));
  out.meshes = scene.meshes.map((mesh) => ({
    vertices: new Float32Array(bytes(mesh.vertices)),
    normals: new Float32Array(bytes(mesh.normals)),
    faces: new Uint32Array(bytes(mesh.faces)),
    face_normals: new Uint32Array(bytes(mesh.face_normals)),
  }));
  return out;
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
  // edges are broken a little, as those of real parts: they catch the light
  const b = Math.min(0.12 * Math.min(radius, half), 0.0025), steps = detail > 5 ? 2 : 1;
  return lathe([[0, -half, 0, -1], ...arc(-QUARTER, 0, steps, b, radius - b, b - half),
    ...arc(0, QUARTER, steps, b, radius - b, half - b), [0, half, 0, 1]], 2 * detail);
}

function box(size, detail) {
  // the surface of a cube whose points are pushed out of an inner box by the edges' radius
  const b = Math.min(0.2 * Math.min(...size), 0.004), steps = detail > 8 ? 2 : 1;
  const points = [], normals = [], faces = [];
  const line = (h) => {
    const out = [];
    for (let i = 0; i <= steps; i++) out.push(-h + b - b * Math.cos((QUARTER * i) / steps));
    return [...out, ...out.map((x) => -x).reverse()];
  };
  for (let axis = 0; axis < 3; axis++)
    for (const side of [-1, 1]) {
      const u = (axis + 1) % 3, v = (axis + 2) % 3, us = line(size[u]), vs = line(size[v]);
      const first = points.length / 3;
      for (const y of vs)
        for (const x of us) {
          const p = [0, 0, 0];
          [p[axis], p[u], p[v]] = [side * size[axis], x, y];
          const inner = p.map((c, k) => clamp(c, b - size[k], size[k] - b));
          const n = unit(sub(p, inner));
          points.push(...add(inner, scale(n, b)));
          normals.push(...n);
        }
      const w = us.length;
      for (let j = 0; j + 1 < vs.length; j++)
        for (let i = 0; i + 1 < w; i++) {
          const a = first + j * w + i, c = a + w;
          faces.push(...(side > 0 ? [a, a + 1, c + 1, a, c + 1, c] : [a, c + 1, a + 1, a, c, c + 1]));
        }
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
  return box(geom.size, most);
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
  for (const [v, color, k] of pairs) {
    const speed = Math.hypot(v[0], v[1]);
    const at = add(base.position, [0, 0, size * (0.3 + 0.085 * k)]);
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

// ---- 4 WebGL

const SUN = unit([0.42, -0.52, 0.86]);  // towards it; close to the light of the robots' MJCF
const SHADOW = 2048, BELOW = 512;  // texels of a side: shadow of the sun; height map for contact

// Colours are linear inside the shaders; `finish` is specular, shininess, emission of the MJCF.
const LIGHT = `#version 300 es
precision highp float;
precision highp sampler2DShadow;
uniform vec3 eye, sun, center;
uniform float size, ground;
uniform int level;  // 0: all that a graphics card can do with ease, to 3: what a processor can
uniform mat4 sunView, belowView, aboveView;
uniform sampler2DShadow sunShadow;
uniform sampler2D sunDepth, belowDepth, aboveDepth;
const vec3 HORIZON = vec3(1.12, 1.21, 1.31), ZENITH = vec3(0.26, 0.46, 0.80);
const vec3 SUNLIGHT = vec3(2.35, 2.22, 2.02);

vec3 sky(vec3 d) {
  return mix(HORIZON, ZENITH, pow(clamp(d.z, 0.0, 1.0), 0.55));
}
// what a surface mirrors: floor, sky, and a large soft light above
vec3 surroundings(vec3 d, float rough) {
  float soft = mix(0.03, 0.5, rough);
  vec3 c = mix(vec3(0.40, 0.41, 0.43), sky(vec3(d.xy, abs(d.z) * 0.7)), smoothstep(-soft, soft, d.z));
  float lamp = smoothstep(0.80 - soft, 0.80 + soft, dot(d, normalize(vec3(0.25, 0.3, 0.92))));
  return c + vec3(1.5, 1.5, 1.55) * lamp * (1.0 - 0.6 * rough);
}
float noise(vec2 p) {
  return fract(52.9829189 * fract(dot(p, vec2(0.06711056, 0.00583715))));
}
vec2 disc(int i, int n, float spin, float power) {
  float a = float(i) * 2.39996323 + spin * 6.2831853;
  return pow((float(i) + 0.5) / float(n), power) * vec2(cos(a), sin(a));
}
// share of the sun that reaches p; the penumbra grows with the distance to what casts the shadow
float sunlight(vec3 p, vec3 n) {
  vec4 q = sunView * vec4(p + n * 0.014 * size, 1.0);
  vec3 c = q.xyz * 0.5 + 0.5;
  if (any(lessThan(c, vec3(0.0))) || any(greaterThan(c, vec3(1.0)))) return 1.0;
  if (level > 2) return texture(sunShadow, vec3(c.xy, c.z - 0.0012));
  int near = 16 >> level, taps = 28 >> level;
  float spin = noise(gl_FragCoord.xy), blockers = 0.0, depth = 0.0;
  for (int i = 0; i < near; i++) {
    float d = texture(sunDepth, c.xy + disc(i, near, spin, 0.5) * 0.014).r;
    if (d < c.z - 0.0012) { blockers += 1.0; depth += d; }
  }
  if (blockers < 0.5) return 1.0;
  float width = clamp((c.z - depth / blockers) * 0.10, 0.0010, 0.014), light = 0.0;
  for (int i = 0; i < taps; i++)
    light += texture(sunShadow, vec3(c.xy + disc(i, taps, spin, 0.5) * width, c.z - 0.0012));
  return light / float(taps);
}
// share of the sky above p that nothing covers, from heights seen from above
float openness(vec3 p, vec3 n) {
  if (level > 2) return 1.0;
  vec3 c = (aboveView * vec4(p + n * 0.02 * size, 1.0)).xyz * 0.5 + 0.5;
  if (any(lessThan(c.xy, vec2(0.0))) || any(greaterThan(c.xy, vec2(1.0)))) return 1.0;
  int taps = 18 >> level;
  float spin = noise(gl_FragCoord.yx + 17.0), covered = 0.0;
  for (int i = 0; i < taps; i++) {
    float d = texture(aboveDepth, c.xy + disc(i, taps, spin, 0.6) * 0.16).r;
    covered += step(d, c.z - 0.004);
  }
  return 1.0 - covered / float(taps);
}
// darkening of the floor at p by what stands on it, from heights seen from below
float contact(vec3 p) {
  if (level > 2) return 0.0;
  vec2 c = (belowView * vec4(p, 1.0)).xy * 0.5 + 0.5;
  if (any(lessThan(c, vec2(0.0))) || any(greaterThan(c, vec2(1.0)))) return 0.0;
  int taps = 20 >> level;
  float spin = noise(gl_FragCoord.xy + 31.0), dark = 0.0;
  for (int i = 0; i < taps; i++) {
    float height = texture(belowDepth, c + disc(i, taps, spin, 0.9) * 0.045).r * 1.6 * size;
    dark += exp(-max(height, 0.0) / (0.075 * size));
  }
  return dark / float(taps);
}
vec3 develop(vec3 c) {  // exposure, a soft shoulder, and the screen's transfer curve
  c *= 0.62;
  c = c * (2.51 * c + 0.03) / (c * (2.43 * c + 0.59) + 0.14);
  return pow(clamp(c, 0.0, 1.0), vec3(1.0 / 2.2));
}
vec3 haze(vec3 c, vec3 p) {
  float d = length(p - eye) / size;
  return mix(c, sky(normalize(p - eye)), 1.0 - exp(-pow(d / 28.0, 2.2)));
}
`;
const SURFACE_VERTEX = `#version 300 es
in vec3 point, normal, color, finish;
uniform mat4 model, camera;
out vec3 p, n, albedo, coat;
void main() {
  vec4 world = model * vec4(point, 1.0);
  p = world.xyz; n = mat3(model) * normal; albedo = pow(color, vec3(2.2)); coat = finish;
  gl_Position = camera * world;
}`;
const SURFACE = LIGHT + `
in vec3 p, n, albedo, coat;
uniform float mirrored, bright;
out vec4 pixel;
void main() {
  vec3 normal = normalize(n), v = normalize(eye - p);
  if (mirrored > 0.5) { if (p.z > ground) discard; v = normalize(vec3(eye.xy, 2.0 * ground - eye.z) - p); v.z = -v.z; normal.z = -normal.z; }
  vec3 at = mirrored > 0.5 ? vec3(p.xy, 2.0 * ground - p.z) : p;
  float light = max(dot(normal, sun), 0.0);
  if (light > 0.0 && bright < 0.5) light *= sunlight(at, normal);
  float open = bright > 0.5 ? 1.0 : openness(at, normal);
  float up = normal.z * 0.5 + 0.5, low = smoothstep(0.0, 0.30 * size, at.z - ground);
  vec3 bounce = vec3(0.34, 0.34, 0.35) * mix(0.35, 1.0, low) * mix(0.55, 1.0, open);
  vec3 ambient = mix(bounce, vec3(0.70, 0.76, 0.86) * mix(0.30, 1.0, open), up);
  float rough = mix(0.72, 0.20, coat.y), a = rough * rough, a2 = a * a;
  vec3 h = normalize(v + sun);
  float nh = max(dot(normal, h), 0.0), nv = max(dot(normal, v), 0.02), vh = max(dot(v, h), 0.0);
  float d = a2 / (3.14159 * pow(nh * nh * (a2 - 1.0) + 1.0, 2.0));
  float f0 = 0.02 + 0.06 * coat.x, k = a * 0.5;
  float fresnel = f0 + (1.0 - f0) * pow(1.0 - vh, 5.0);
  float glint = min(d * fresnel / (4.0 * mix(nv, 1.0, k) * mix(max(dot(normal, sun), 0.02), 1.0, k)), 6.0);
  float edge = f0 + (max(1.0 - rough, f0) - f0) * pow(1.0 - nv, 5.0);
  vec3 r = reflect(-v, normal);
  vec3 c = albedo * (ambient + SUNLIGHT * light * 0.62);
  c += glint * light * SUNLIGHT * min(coat.x * 2.0, 1.0);
  c += surroundings(r, rough) * edge * mix(0.2, 0.8, open) * min(coat.x * 1.6, 1.0);
  c = mix(c, albedo * 1.35, max(coat.z, bright * 0.55));
  c = haze(c, at);
  if (mirrored > 0.5) c = mix(c, vec3(0.60, 0.61, 0.63), smoothstep(0.0, 0.5 * size, at.z - ground));
  pixel = vec4(develop(c), 1.0);
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
out vec4 pixel;
// checkerboard, filtered with a box as wide as the pixel (the integral of a square wave, squared)
float checker(vec2 x, vec2 w) {
  vec2 i = 2.0 * (abs(fract((x - 0.5 * w) * 0.5) - 0.5) - abs(fract((x + 0.5 * w) * 0.5) - 0.5)) / w;
  return 0.5 - 0.5 * i.x * i.y;
}
float lines(vec2 x, vec2 w, float width) {
  vec2 d = abs(fract(x - 0.5) - 0.5), soft = max(w, vec2(width));
  vec2 l = (1.0 - smoothstep(vec2(0.0), soft, d)) * min(width / soft, 1.0);
  return max(l.x, l.y);
}
void main() {
  vec2 x = p.xy / tile, w = max(fwidth(x), vec2(1e-4));
  vec3 albedo = mix(vec3(0.45, 0.462, 0.48), vec3(0.535, 0.547, 0.563), checker(x, w));
  albedo = mix(albedo, vec3(0.62, 0.63, 0.645), 0.5 * lines(x * 0.5, w * 0.5, 0.006));
  float near = 1.0 - smoothstep(2.6, 3.6, length(p.xy - center.xy) / size);
  float light = sun.z, open = 1.0, dark = 0.0;
  if (near > 0.0) {
    light *= mix(1.0, sunlight(p, vec3(0.0, 0.0, 1.0)), near);
    open = mix(1.0, openness(p, vec3(0.0, 0.0, 1.0)), near);
    dark = contact(p) * near;
  }
  vec3 v = normalize(eye - p);
  vec3 c = albedo * (vec3(0.66, 0.71, 0.80) * mix(0.55, 1.0, open) * (1.0 - 0.75 * dark) + SUNLIGHT * light * 0.62 * (1.0 - 0.35 * dark));
  float fresnel = pow(1.0 - max(v.z, 0.0), 5.0);
  c = haze(c + 0.07 * fresnel * HORIZON, p);
  pixel = vec4(develop(c), 1.0 - (0.10 + 0.25 * fresnel) * near);
}`;
const SKY_VERTEX = `#version 300 es
in vec3 point;
uniform mat4 unproject;
uniform vec3 eye;
out vec3 d;
void main() {
  vec4 far = unproject * vec4(point.xy, 1.0, 1.0);
  d = far.xyz / far.w - eye;
  gl_Position = vec4(point.xy, 1.0, 1.0);
}`;
const SKY = LIGHT + `
in vec3 d;
out vec4 pixel;
void main() { pixel = vec4(develop(sky(normalize(d))) + (noise(gl_FragCoord.xy) - 0.5) / 255.0, 1.0); }`;
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

// a square depth texture to draw into
function depthMap(gl, side) {
  const texture = gl.createTexture(), target = gl.createFramebuffer();
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.texStorage2D(gl.TEXTURE_2D, 1, gl.DEPTH_COMPONENT24, side, side);
  gl.bindFramebuffer(gl.FRAMEBUFFER, target);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, texture, 0);
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  return { texture, target, side };
}

function sampler(gl, filter, compare) {
  const s = gl.createSampler();
  for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.samplerParameteri(s, name, filter);
  for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.samplerParameteri(s, name, gl.CLAMP_TO_EDGE);
  if (compare) {
    gl.samplerParameteri(s, gl.TEXTURE_COMPARE_MODE, gl.COMPARE_REF_TO_TEXTURE);
    gl.samplerParameteri(s, gl.TEXTURE_COMPARE_FUNC, gl.LEQUAL);
  }
  return s;
}

function invert(m) {  // of a 4 x 4 matrix, by Gauss-Jordan
  const a = [], n = 4;
  for (let r = 0; r < n; r++) {
    a.push([]);
    for (let c = 0; c < n; c++) a[r].push(m[4 * c + r]);
    for (let c = 0; c < n; c++) a[r].push(r === c ? 1 : 0);
  }
  for (let k = 0; k < n; k++) {
    let pivot = k;
    for (let r = k; r < n; r++) if (Math.abs(a[r][k]) > Math.abs(a[pivot][k])) pivot = r;
    [a[k], a[pivot]] = [a[pivot], a[k]];
    const d = a[k][k];
    a[k] = a[k].map((x) => x / d);
    for (let r = 0; r < n; r++) if (r !== k) {
      const f = a[r][k];
      a[r] = a[r].map((x, c) => x - f * a[k][c]);
    }
  }
  const out = [];
  for (let c = 0; c < n; c++) for (let r = 0; r < n; r++) out.push(a[r][n + c]);
  return out;
}

// the cameras of the depth maps: from the sun, from under the floor, from above
function lamps(scene, center) {
  const half = 2.6 * scene.radius, snap = (2 * half) / SHADOW;
  const side = lookAt(SUN, [0, 0, 0], [0, 0, 1]);
  // moved by whole texels only, else the edges of shadows crawl
  const at = [0, 1, 2].map((k) => side[k] * center[0] + side[4 + k] * center[1] + side[8 + k] * center[2]);
  const move = at.map((x, k) => (k < 2 ? Math.round(x / snap) * snap : x));
  const view = [...side];
  for (let k = 0; k < 3; k++) view[12 + k] = -move[k] - (k === 2 ? 2 * half : 0);
  const low = [center[0], center[1], scene.floor], height = 1.6 * scene.radius;
  const below = lookAt(add(low, [0, 0, -1]), low, [0, 1, 0]);
  const above = lookAt(add(low, [0, 0, 4 * height]), low, [0, 1, 0]);
  const reach = 1.5 * scene.radius;
  return {
    sun: times(orthographic(half, 0, 4 * half), view),
    below: times(orthographic(reach, 1, 1 + height), below),
    above: times(orthographic(reach, 0, 4 * height), above),
  };
}

// draw(state) for WebGL 2, or null where the browser has none
function webgl(canvas, scene) {
  const gl = canvas.getContext("webgl2", { antialias: true, alpha: false, powerPreference: "high-performance" });
  if (!gl) return null;
  const surface = link(gl, SURFACE_VERTEX, SURFACE), floor = link(gl, FLOOR_VERTEX, FLOOR);
  const sky = link(gl, SKY_VERTEX, SKY), depth = link(gl, DEPTH_VERTEX, DEPTH);
  const line = link(gl, TRAIL_VERTEX, TRAIL);
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
  const maps = { sun: depthMap(gl, SHADOW), below: depthMap(gl, BELOW), above: depthMap(gl, BELOW) };
  const compare = sampler(gl, gl.LINEAR, true), plain = sampler(gl, gl.NEAREST, false);
  const units = [["sunShadow", maps.sun, compare], ["sunDepth", maps.sun, plain],
    ["belowDepth", maps.below, plain], ["aboveDepth", maps.above, plain]];
  units.forEach(([, map, how], i) => {
    gl.activeTexture(gl.TEXTURE0 + i);
    gl.bindTexture(gl.TEXTURE_2D, map.texture);
    gl.bindSampler(i, how);
  });
  const whole = matrix([0, 0, 0], rotation([1, 0, 0, 0]));

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

  return function render(state) {
    const { camera, bodies, kind } = state, width = canvas.width, height = canvas.height;
    const { eye, view, projection } = shoot(camera, width / height);
    const matrices = bodies.map((b) => matrix(b.position, rotation(b.quat)));
    const base = bodies[scene.base].position, center = [base[0], base[1], scene.floor + 0.3 * scene.radius];
    const lamp = lamps(scene, center), seen = times(projection, view);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);  // the sky lies on the far plane
    gl.enable(gl.CULL_FACE);
    gl.disable(gl.BLEND);
    for (const [name, map] of Object.entries(maps)) {
      if (state.level > 2 && name !== "sun") continue;
      gl.bindFramebuffer(gl.FRAMEBUFFER, map.target);
      gl.viewport(0, 0, map.side, map.side);
      gl.clear(gl.DEPTH_BUFFER_BIT);
      use(depth, { camera: lamp[name] });
      robot(depth, kind, matrices);
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, width, height);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const world = { eye, sun: SUN, center, size: scene.radius, ground: scene.floor,
      sunView: lamp.sun, belowView: lamp.below, aboveView: lamp.above, camera: seen,
      unproject: invert(seen), tile: scene.tile, level: state.level, mirrored: 0, bright: 0 };
    units.forEach(([name], i) => (world[name] = i));

    gl.depthMask(false);
    use(sky, world);
    draw(square);
    gl.depthMask(true);
    // the floor mirrors a little: the robot upside down, seen through the floor
    const mirror = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, -1, 0, 0, 0, 2 * scene.floor, 1];
    gl.frontFace(gl.CW);
    use(surface, { ...world, mirrored: 1 });
    if (state.level < 2) robot(surface, kind, matrices.map((m) => times(mirror, m)));
    gl.frontFace(gl.CCW);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    gl.disable(gl.CULL_FACE);
    use(floor, world);
    draw(square);
    const path = ribbon(trail(scene, state.row), 0.008 * scene.radius, scene.floor + 0.002 * scene.radius);
    if (path) {
      const mesh = upload(gl, path, gl.STREAM_DRAW);
      gl.depthMask(false);
      use(line, world);
      draw(mesh);
      gl.depthMask(true);
      mesh.free();
    }
    gl.disable(gl.BLEND);
    gl.enable(gl.CULL_FACE);
    use(surface, world);
    robot(surface, kind, matrices);
    use(surface, { model: whole, bright: 1 });
    for (const mesh of arrows(scene, bodies, state.command, state.velocity)) {
      const on = upload(gl, mesh, gl.STREAM_DRAW);
      gl.vertexAttrib3fv(2, mesh.color);
      gl.vertexAttrib3fv(3, [0.5, 0.5, 0]);
      draw(on);
      on.free();
    }
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

// ---- 5 canvas: flat triangles from far to near, for browsers without WebGL 2

function flat(canvas, scene) {
  const pen = canvas.getContext("2d");
  const kinds = { looks: (g) => g.group < 3, contacts: (g) => g.group >= 3 || g.body < 0 };
  const meshes = {};
  for (const [kind, wanted] of Object.entries(kinds)) {
    meshes[kind] = [];
    for (let body = -1; body < scene.bodies; body++)
      meshes[kind].push({ body, ...merge(scene, body, wanted, 5) });
  }
  return function render(state) {
    const { camera, bodies, kind } = state, w = canvas.width, h = canvas.height;
    const { eye, view, projection } = shoot(camera, w / h), seen = times(projection, view);
    const project = (p) => {
      const out = [0, 1, 3].map((k) => seen[k] * p[0] + seen[4 + k] * p[1] + seen[8 + k] * p[2] + seen[12 + k]);
      return out[2] < 0.05 ? null : [(0.5 + (0.5 * out[0]) / out[2]) * w, (0.5 - (0.5 * out[1]) / out[2]) * h, out[2]];
    };
    const polygon = (points) => {
      if (points.some((p) => !p)) return false;
      points.forEach((p, i) => (i ? pen.lineTo(p[0], p[1]) : pen.moveTo(p[0], p[1])));
      return true;
    };
    const back = pen.createLinearGradient(0, 0, 0, h);
    back.addColorStop(0, "#a9bfd8");
    back.addColorStop(0.45, "#dfe7ef");
    back.addColorStop(1, "#dfe7ef");
    pen.fillStyle = back;
    pen.fillRect(0, 0, w, h);
    const base = bodies[scene.base].position, tile = scene.tile, reach = Math.ceil((9 * scene.radius) / tile);
    const i0 = Math.floor(base[0] / tile), j0 = Math.floor(base[1] / tile);
    for (let i = i0 - reach; i <= i0 + reach; i++)
      for (let j = j0 - reach; j <= j0 + reach; j++) {
        const fade = 1 - Math.hypot(i - i0, j - j0) / reach;
        if (fade <= 0) continue;
        const corners = [[0, 0], [1, 0], [1, 1], [0, 1]]
          .map(([a, b]) => project([(i + a) * tile, (j + b) * tile, scene.floor]));
        pen.fillStyle = (i + j) & 1 ? `rgba(190,194,198,${fade})` : `rgba(204,208,211,${fade})`;
        pen.beginPath();
        if (polygon(corners)) pen.fill();
      }
    const triangles = [];
    pen.beginPath();  // the shadow: every triangle laid flat along the sun's rays
    const dark = ([a, b, c]) => {  // all turning one way, so that they add up to one outline
      if (!a || !b || !c) return;
      const left = (b[0] - a[0]) * (c[1] - a[1]) > (b[1] - a[1]) * (c[0] - a[0]);
      polygon(left ? [a, b, c] : [a, c, b]);
    };
    const take = (points, normals, faces, colors, shaded) => {
      const on = [];
      for (let i = 0; i < points.length; i += 3) on.push(project(points.slice(i, i + 3)));
      for (let i = 0; i < faces.length; i += 3) {
        const [a, b, c] = [faces[i], faces[i + 1], faces[i + 2]], p = 3 * a;
        const n = [normals[p], normals[p + 1], normals[p + 2]];
        if (shaded)
          dark([a, b, c].map((f) => {
            const s = (points[3 * f + 2] - scene.floor) / SUN[2];
            return project([points[3 * f] - SUN[0] * s, points[3 * f + 1] - SUN[1] * s, scene.floor]);
          }));
        if (!on[a] || !on[b] || !on[c] || dot(n, sub(eye, points.slice(p, p + 3))) < 0) continue;
        const light = 0.5 + 0.2 * n[2] + 0.45 * Math.max(dot(n, SUN), 0);
        triangles.push([on[a][2] + on[b][2] + on[c][2], on[a], on[b], on[c],
          [0, 1, 2].map((k) => Math.round(255 * Math.min(1, colors(p)[k] * light)))]);
      }
    };
    for (const mesh of meshes[kind]) {
      const r = mesh.body < 0 ? rotation([1, 0, 0, 0]) : rotation(bodies[mesh.body].quat);
      const at = mesh.body < 0 ? [0, 0, 0] : bodies[mesh.body].position, points = [], normals = [];
      for (let i = 0; i < mesh.points.length; i += 3) {
        points.push(...add(turn(r, mesh.points.slice(i, i + 3)), at));
        normals.push(...turn(r, mesh.normals.slice(i, i + 3)));
      }
      take(points, normals, mesh.faces, (p) => mesh.colors.slice(p, p + 3), true);
    }
    pen.fillStyle = "rgba(70,76,86,0.45)";
    pen.fill("nonzero");
    for (const a of arrows(scene, bodies, state.command, state.velocity))
      take(a.points, a.normals, a.faces, () => a.color, false);
    triangles.sort((a, b) => b[0] - a[0]);
    for (const [, a, b, c, color] of triangles) {
      pen.fillStyle = pen.strokeStyle = `rgb(${color.join(",")})`;
      pen.beginPath();
      polygon([a, b, c]);
      pen.fill();
      pen.stroke();
    }
  };
}

// ---- 6 the page

const SHARP = [1, 1, 0.75, 0.5];  // pixels a screen pixel, by level
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
    for (const [values, color, width, strong] of lines) {
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
  let canvas = $("stage"), render = null;
  try {
    render = /[#&]flat/.test(location.hash) ? null : webgl(canvas, scene);
  } catch (error) {
    console.warn(error.message);
  }
  if (!render) {
    const other = canvas.cloneNode();  // a canvas has one kind of context in its life
    canvas.replaceWith(other);
    canvas = other;
    render = flat(canvas, scene);
    $("note").hidden = false;
  }
  const home = { azimuth: -0.66, elevation: 0.2, distance: 4.6 * scene.radius };
  const camera = { ...home, fovy: 0.55, target: [0, 0, 0] };
  const state = { row: 0, playing: true, speed: 1, follow: true, kind: "looks", level: 0, held: 0 };
  const start = /[#&]t=([\d.]+)/.exec(location.hash);  // page.html#t=2.5 shows that moment; also #contacts, #flat
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
    seek(0);
    play(true);
  });
  drag(canvas, camera, (moved) => moved && toggle("follow", false));
  scrub($("chart"), (share) => (play(false), seek(share * last)));

  let before = performance.now(), late = -4;  // the first pictures take longer
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
    // a machine that cannot keep up gets a simpler picture, with fewer pixels
    late = took > 0.05 ? late + 1 + Math.floor(took / 0.2) : 0;
    if (late > 4 && state.level < 3) [state.level, late] = [state.level + 1, 0];
    if (state.follow) {
      const goal = aim(state.row), pull = state.playing ? 1 - Math.exp(-passed * 12) : 1;
      camera.target = camera.target.map((x, k) => mix(x, goal[k], pull));
    }
    show(passed);
    requestAnimationFrame(frame);
  }
  function show() {
    const ratio = Math.min(devicePixelRatio || 1, 2) * SHARP[state.level];
    const w = Math.max(1, Math.round(canvas.clientWidth * ratio)), h = Math.max(1, Math.round(canvas.clientHeight * ratio));
    if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
    const command = motion(scene.command, state.row, scene.rows);
    const velocity = motion(scene.velocity, state.row, scene.rows);
    render({ ...state, camera, command, velocity, bodies: pose(scene, state.row) });
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
