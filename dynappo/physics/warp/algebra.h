// What the kernels of quadruped.py and tree.py share, the first part of their functions: vectors, inertias,
// constraints, motors, and how far a part reaches down.
//
// Frames: axes of the world, origin at the base. A spatial vector is two arguments, angular and linear;
// of a force: its moment about the origin, and it.
using wp::vec3;
using wp::mat33;
using wp::cross;
using wp::dot;
using wp::mul;

auto read3 = [](const float* p) { return vec3(p[0], p[1], p[2]); };
auto read33 = [](const float* p) {
  return mat33(p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8]);
};
auto about = [](vec3 a, float angle) {  // Rodrigues
  const float s = sinf(angle), c = cosf(angle), d = 1.0f - c;
  return mat33(c + d * a[0] * a[0], d * a[0] * a[1] - s * a[2], d * a[0] * a[2] + s * a[1],
               d * a[0] * a[1] + s * a[2], c + d * a[1] * a[1], d * a[1] * a[2] - s * a[0],
               d * a[0] * a[2] - s * a[1], d * a[1] * a[2] + s * a[0], c + d * a[2] * a[2]);
};
auto skew = [](vec3 a) {
  return mat33(0.0f, -a[2], a[1], a[2], 0.0f, -a[0], -a[1], a[0], 0.0f);
};

struct Inertia {  // about the origin: mass, mass x centre, second moments
  float m;
  vec3 h;
  mat33 I;
  void add(const Inertia& o) { m += o.m, h = h + o.h, I = I + o.I; }
  vec3 moment(vec3 ang, vec3 lin) const { return wp::mul(I, ang) + wp::cross(h, lin); }
  vec3 force(vec3 ang, vec3 lin) const { return lin * m + wp::cross(ang, h); }
};
auto inertia_of = [&](float m, vec3 diagonal, vec3 centre, mat33 turn) {
  mat33 scaled = turn;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) scaled.data[i][j] *= diagonal[j];
  mat33 I = mul(scaled, wp::transpose(turn));
  const float d2 = dot(centre, centre);
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      I.data[i][j] += m * ((i == j ? d2 : 0.0f) - centre[i] * centre[j]);
  return Inertia{m, centre * m, I};
};

// Stiffness of a constraint that is `depth` < 0 deep: the share of its acceleration that it takes, by
// MuJoCo's impedance (modeling.html, solver parameters). p: its solimp, b, k, invweight.
auto impedance = [](const float* p, float depth) {
  const float x = fabsf(depth) / p[2], mid = p[3], power = p[4];
  float y = x <= mid ? powf(x, power) / powf(mid, power - 1.0f)
                     : 1.0f - powf(1.0f - x, power) / powf(1.0f - mid, power - 1.0f);
  if (x >= 1.0f) y = 1.0f;
  return p[0] + y * (p[1] - p[0]);
};
auto stiffness = [](float invweight, float imp) {
  return 1.0f / wp::max(invweight * (1.0f - imp) / imp, 1e-15f);
};

// The force (and moment) that gives a body the acceleration (aa, al) at the velocity (w, u).
auto momentum_rate = [](const Inertia& I, vec3 w, vec3 u, vec3 aa, vec3 al, vec3& moment, vec3& force) {
  const vec3 p = I.force(w, u);
  moment = I.moment(aa, al) + cross(w, I.moment(w, u)) + cross(u, p);
  force = I.force(aa, al) + cross(w, p);
};

// r = A^-1 r of the base's six equations: Cholesky, with inverses on the diagonal. NaN where A is not positive
// definite.
auto at = [](int i, int j) { return i * (i + 1) / 2 + j; };  // of a lower triangle
auto solve_base = [&](float* A, float* r) {
  for (int j = 0; j < 6; ++j)
    for (int i = j; i < 6; ++i) {
      float s = A[at(i, j)];
      for (int k = 0; k < j; ++k) s -= A[at(i, k)] * A[at(j, k)];
      A[at(i, j)] = i == j ? 1.0f / sqrtf(s) : s * A[at(j, j)];
    }
  for (int i = 0; i < 6; ++i) {
    for (int k = 0; k < i; ++k) r[i] -= A[at(i, k)] * r[k];
    r[i] *= A[at(i, i)];
  }
  for (int i = 5; i >= 0; --i) {
    for (int k = i + 1; k < 6; ++k) r[i] -= A[at(k, i)] * r[k];
    r[i] *= A[at(i, i)];
  }
};

// A motor's torque (actuators.py: pd, clip_dc_motor, lag); compared so that NaN stays NaN. p: arrays.MOTOR;
// `before`: of the last physics step.
auto motor_torque = [](const float* p, float target, float angle, float qd, float before) {
  const float kp = p[0], kd = p[1], effort = p[2], saturation = p[3];
  const float speed = p[4], strength = p[5], share = p[7];
  float t = kp * (target - angle) - kd * qd;
  const float most = speed * (1.0f + effort / saturation);
  const float slope = wp::min(wp::max(qd, -most), most) / speed;
  const float upper = wp::min(saturation * (1.0f - slope), effort);
  const float lower = wp::max(saturation * (-1.0f - slope), -effort);
  if (t > upper) t = upper;
  else if (t < lower) t = lower;
  t = t * strength;
  return share < 1.0f ? before + share * (t - before) : t;
};
auto rubbing = [&](const float* p, float qd) { return p[6] * tanhf(qd / FRICTION_SPEED); };

// The lowest point of a part (contacts.py), below its link's origin where negative. R: the link's axes;
// g: its place and rotation in the link, then `contacts.floor_distance`.
auto lowest_point = [&](const float* g, mat33 R) {
  const vec3 down(R.data[2][0], R.data[2][1], R.data[2][2]);
  const vec3 z = mul(wp::transpose(read33(g + 3)), down);
  return mul(R, read3(g))[2] - (g[12] + g[13] * fabsf(z[0]) + g[14] * fabsf(z[1]) + g[15] * fabsf(z[2]) +
                                g[16] * sqrtf(wp::max(1.0f - z[2] * z[2], 0.0f)));
};
