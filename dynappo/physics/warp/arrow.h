// The second part of the function of quadruped.py: whose thread this is, and the equations of a robot of a base
// and four legs, whose matrix has the shape of an arrow.
//
// Four threads a robot on a GPU, a leg each (LEGS = 1): all numbers of a leg are a thread's own, and
// threads meet only to add what the legs do to the base (`total`). On a CPU one thread does all legs
// (LEGS = 4), with the same lines.
#if defined(__CUDA_ARCH__)
enum { LEGS = 1 };
const int robot = thread / 4, leg0 = thread % 4;
const unsigned us = 0xFu << (threadIdx.x & 28);  // the four threads of this robot
#else
enum { LEGS = 4 };
const int robot = thread, leg0 = 0;
#endif

// Sum over the legs, the same bits in all four threads.
auto total = [&](float x) {
#if defined(__CUDA_ARCH__)
  x += __shfl_xor_sync(us, x, 1);
  x += __shfl_xor_sync(us, x, 2);
#endif
  return x;
};
auto total3 = [&](vec3 x) { return vec3(total(x[0]), total(x[1]), total(x[2])); };

// x = A^-1 b of the matrix of the whole robot: `own` [6] of each leg's joints (3 x 3), `arm` [3] the
// joints' columns against the base, `base` [21] the base's own. Legs meet only at the base, so each leg
// is eliminated first (Schur). Negative where not positive definite: NaN.
using Joints = float[3];
struct Leg {
  float own[6];
  vec3 ang[3], lin[3];
};
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
  solve_base(A, r);
  x_lin = vec3(r[0], r[1], r[2]), x_ang = vec3(r[3], r[4], r[5]);
  for (int l = 0; l < LEGS; ++l)
    for (int k = 0; k < 3; ++k) {
      x[l][k] = z[l][k];
      for (int i = 0; i < 6; ++i) x[l][k] -= Y[l][k][i] * r[i];
    }
};
