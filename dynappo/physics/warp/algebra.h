// The first half of the function of quadruped.py: whose thread this is, and the equations of a robot of
// a base and four legs. quadruped.h is the second half.
//
// Four threads a robot on a GPU, a leg each (LEGS = 1): all numbers of a leg are a thread's own, and
// threads meet only to add what the legs do to the base (`total`). On a CPU one thread does all legs
// (LEGS = 4), with the same lines.
//
// Frames: axes of the world, origin at the base. A spatial vector is two arguments, angular and linear;
// of a force: its moment about the origin, and it.
#if defined(__CUDA_ARCH__)
enum { LEGS = 1 };
const int robot = thread / 4, leg0 = thread % 4;
const unsigned us = 0xFu << (threadIdx.x & 28);  // the four threads of this robot
#else
enum { LEGS = 4 };
const int robot = thread, leg0 = 0;
#endif
using wp::vec3;
using wp::mat33;
using wp::cross;
using wp::dot;
using wp::mul;

// Sum over the legs, the same bits in all four threads.
auto total = [&](float x) {
#if defined(__CUDA_ARCH__)
  x += __shfl_xor_sync(us, x, 1);
  x += __shfl_xor_sync(us, x, 2);
#endif
  return x;
};
auto total3 = [&](vec3 x) { return vec3(total(x[0]), total(x[1]), total(x[2])); };
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

// x = A^-1 b of the matrix of the whole robot: `own` [6] of each leg's joints (3 x 3), `arm` [3] the
// joints' columns against the base, `base` [21] the base's own. Legs meet only at the base, so each leg
// is eliminated first (Schur). Negative where not positive definite: NaN.
using Joints = float[3];
struct Leg {
  float own[6];
  vec3 ang[3], lin[3];
};
auto at = [](int i, int j) { return i * (i + 1) / 2 + j; };  // of a lower triangle
auto solve = [&](const Leg* legs, const float* base, const Joints* b, vec3 b_lin, vec3 b_ang,
                 Joints* x, vec3& x_lin, vec3& x_ang) {
  float Y[LEGS][3][6], z[LEGS][3], A[21], r[6];
  for (int i = 0; i < 21; ++i) A[i] = 0.0f;
  for (int i = 0; i < 6; ++i) r[i] = 0.0f;
  for (int l = 0; l < LEGS; ++l) {
    const float* h = legs[l].own;
    const float l00 = 1.0f / sqrtf(h[0]), l10 = h[1] * l00, l20 = h[3] * l00;
    const float l11 = 1.0f / sqrtf(h[2] - l10 * l10), l21 = (h[4] - l20 * l10) * l11;
    const float l22 = 1.0f / sqrtf(h[5] - l20 * l20 - l21 * l21);
    auto own_inverse = [&](float& a, float& c, float& d) {
      a *= l00, c = (c - l10 * a) * l11, d = (d - l20 * a - l21 * c) * l22;
      d *= l22, c = (c - l21 * d) * l11, a = (a - l10 * c - l20 * d) * l00;
    };
    float B[3][6];
    for (int k = 0; k < 3; ++k)
      for (int i = 0; i < 3; ++i) {
        B[k][i] = Y[l][k][i] = legs[l].lin[k][i];
        B[k][i + 3] = Y[l][k][i + 3] = legs[l].ang[k][i];
      }
    for (int i = 0; i < 6; ++i) own_inverse(Y[l][0][i], Y[l][1][i], Y[l][2][i]);
    for (int k = 0; k < 3; ++k) z[l][k] = b[l][k];
    own_inverse(z[l][0], z[l][1], z[l][2]);
    for (int k = 0; k < 3; ++k)
      for (int i = 0; i < 6; ++i) {
        for (int j = 0; j <= i; ++j) A[at(i, j)] -= B[k][i] * Y[l][k][j];
        r[i] -= B[k][i] * z[l][k];
      }
  }
  for (int i = 0; i < 21; ++i) A[i] = base[i] + total(A[i]);
  for (int i = 0; i < 3; ++i) r[i] = b_lin[i] + total(r[i]), r[i + 3] = b_ang[i] + total(r[i + 3]);
  for (int j = 0; j < 6; ++j)  // Cholesky; inverses on the diagonal
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
  x_lin = vec3(r[0], r[1], r[2]), x_ang = vec3(r[3], r[4], r[5]);
  for (int l = 0; l < LEGS; ++l)
    for (int k = 0; k < 3; ++k) {
      x[l][k] = z[l][k];
      for (int i = 0; i < 6; ++i) x[l][k] -= Y[l][k][i] * r[i];
    }
};
