// The second part of the function of tree.py: a control step of a robot that is a tree of hinges on a free
// base, with its feet on a plane, or (GROUND) on a height map: each sphere of a foot, and each end of a capsule,
// then has one contact, with the nearest triangle; MuJoCo's own has one with every triangle that the shape
// reaches, anywhere along a capsule.
//
// On a GPU a warp is a robot, and its 32 threads take what there is to do in turns: EACH(i, n) gives thread i
// item i: a joint, an edge of a contact, an entry of a matrix. What a thread leaves for others is in `S`;
// SYNC() between two phases makes it seen. On a CPU one thread does it all, with the same lines.
//
// Arrays are rows of one number a joint, so that threads side by side read words side by side. Column JOINTS
// is the base. Spatial vectors are rows 0 to 2 linear (force), 3 to 5 angular (moment), as the base's own
// six degrees of freedom are.
#if defined(__CUDA_ARCH__)
#define SYNC() __syncwarp()
#define SHARED __shared__
enum { LANES = 32 };
const int robot = thread / 32, lane = threadIdx.x & 31;
#else
#define SYNC()
#define SHARED
enum { LANES = 1 };
const int robot = thread, lane = 0;
#endif
#define EACH(i, n) for (int i = lane; i < (n); i += LANES)

// Sum over the threads, the same bits in all.
auto total = [](float x) {
#if defined(__CUDA_ARCH__)
  for (int way = 1; way < 32; way *= 2) x += __shfl_xor_sync(0xFFFFFFFFu, x, way);
#endif
  return x;
};

// WIDE and LONG are odd: threads that read a column of one row and of the next do not meet in a bank
enum { EDGES = 4 * POINTS, LONG = EDGES | 1, WIDE = (JOINTS + 1) | 1 };
// rows of a matrix: against the base's six, the right-hand side, against the joints above and itself
enum { RHS = 6, OWN = 7, PAIRS = 27 };
using Row = float[WIDE];
struct State {
  float angle[WIDE], rate[WIDE], torque[WIDE], before[WIDE];
  Row pose[2][7];     // a link's place and quaternion
  Row screw[6];       // the velocity that a joint's gives to all below
  Row moving[6];      // a link's velocity
  Row turning[6];     // of a joint, its share of the acceleration of all below
  Row sum[2][16];     // force (6), mass, mass x centre, second moments (6) of a link and all below
  Row M[OWN + DEPTH];  // inertia, and the force without contacts
  Row H[OWN + DEPTH];  // the Hessian and the gradient; then their factors L^T D
  float inverse[WIDE];  // of D
  float x[WIDE], grad[WIDE], step[WIDE], side[WIDE], jar[WIDE], aref[WIDE], D[WIDE];
  float M_base[PAIRS], H_base[PAIRS], x_base[6], step_base[6];
  float edge[7][LONG];  // of a pyramid: a force of 1 along it; what it lacks in acceleration
  float edge_jar[LONG], edge_aref[LONG], edge_D[LONG], edge_on[LONG], along[LONG];
  float depth[POINTS];
#if GROUND
  float normal[POINTS][3];
#endif
  float foot[FEET][6];       // accelerations of the feet's links
  float pull[FEET][PAIRS];  // stiffness and force of a foot's contacts
};
SHARED State S;

// ---- what is there before
const float* const number = numbers.data;
const int* const tree = tables.data;
float* q = qpos.data + robot * (7 + JOINTS);
float* v = qvel.data + robot * (6 + JOINTS);
float* warm = qacc_warmstart.data + robot * (6 + JOINTS);
// the motors' numbers: one row for all joints of a robot, or a row a joint
const int motors = motor.shape[1];
const float* motor_of = motor.data + robot * motors * 8;
// rows of the bodies, one for all robots or one a robot; the world is body 0
auto row = [&](int rows) { return rows == 1 ? 0 : robot; };
const float* mass = body_mass.data + row(body_mass.shape[0]) * body_mass.shape[1];
const vec3* moments = body_inertia.data + row(body_inertia.shape[0]) * body_inertia.shape[1];
const vec3* centre = body_ipos.data + row(body_ipos.shape[0]) * body_ipos.shape[1];
const vec3* rub = geom_friction.data + row(geom_friction.shape[0]) * geom_friction.shape[1];
const float* armature = dof_armature.data + row(dof_armature.shape[0]) * (6 + JOINTS);
#if GROUND
const float* const ground = number + MAP;
#endif
const float h = number[TIMESTEP], gravity = number[GRAVITY], tolerance = number[TOLERANCE];

auto get3 = [](const Row* from, int j) { return vec3(from[0][j], from[1][j], from[2][j]); };
auto get4 = [](const Row* from, int j) {
  return wp::quat(from[0][j], from[1][j], from[2][j], from[3][j]);
};
auto put3 = [](Row* to, int j, vec3 x) { to[0][j] = x[0], to[1][j] = x[1], to[2][j] = x[2]; };
auto put4 = [](Row* to, int j, wp::quat x) {
  to[0][j] = x[0], to[1][j] = x[1], to[2][j] = x[2], to[3][j] = x[3];
};
// numbers of a joint's link, and of a point of contact: field by field
auto link = [&](int field, int j) { return number[LINK + field * JOINTS + j]; };
auto link3 = [&](int field, int j) { return vec3(link(field, j), link(field + 1, j), link(field + 2, j)); };
auto point = [&](int field, int p) { return number[POINT + field * POINTS + p]; };
auto point3 = [&](int field, int p) { return vec3(point(field, p), point(field + 1, p), point(field + 2, p)); };
auto above = [&](int d, int j) { return tree[ABOVE + d * JOINTS + j]; };  // joint, d from the base

vec3 place = read3(q), lin = read3(v), turning = read3(v + 3);  // turning: in the base's axes
wp::quat rotation = wp::normalize(wp::quat(q[4], q[5], q[6], q[3]));
vec3 x_lin = read3(warm), x_ang_own = read3(warm + 3);
EACH(j, JOINTS) {
  S.angle[j] = q[7 + j], S.rate[j] = v[6 + j], S.x[j] = warm[6 + j];
  S.torque[j] = torque.data[robot * JOINTS + j];
}

// ---- the matrix of the whole robot
// Row j of M and H has only joints above j, so the factors L^T D L do, too (Featherstone 2008, chapter 6.5):
// joints of one depth need only what is below them, and are done together, from the ends to the base.

// (M x)_j and, of the base, (M x)_c
auto times = [&](int j) {
  const int depth = tree[LEVEL + j], end = tree[END + j];
  float s = 0.0f, t = 0.0f;
  for (int c = 0; c < 6; ++c) s += S.M[c][j] * S.x_base[c];
  for (int d = 0; d < depth; ++d) s += S.M[OWN + d][j] * S.x[above(d, j)];
  for (int k = j + 1; k < end; ++k) t += S.M[OWN - 1 + depth][k] * S.x[k];
  return s + t;
};
auto times_base = [&](int c) {
  float s = 0.0f, t = 0.0f;
  for (int b = 0; b < 6; ++b) s += S.M_base[b < c ? at(c, b) : at(b, c)] * S.x_base[b];
  for (int k = 0; k < JOINTS; ++k) t += S.M[c][k] * S.x[k];
  return s + t;
};

// S.step, `base` = H^-1 S.H[RHS]; H becomes its factors
auto solve = [&](float* base) {
  int entry[ACROSS / LANES], next[ACROSS / LANES];  // joint, row, the end of what is below it; read ahead
  auto read = [&](int depth, int* to) {
    for (int i = 0; i < ACROSS / LANES; ++i) to[i] = tree[ENTRY + (depth - 1) * ACROSS + i * LANES + lane];
  };
  read(DEPTH, entry);
  #pragma unroll 1
  for (int depth = DEPTH; depth > 0; --depth) {
    const int own = OWN - 1 + depth;
    SYNC();
    if (depth > 1) read(depth - 1, next);
    for (int i = 0; i < ACROSS / LANES; ++i) {
      const int j = entry[i] & 255, c = entry[i] >> 8 & 255, end = entry[i] >> 16;
      if (end > 0) {
        float s = S.H[c][j];
        for (int k = j + 1; k < end; ++k) s -= S.H[own][k] * S.inverse[k] * S.H[c][k];
        S.H[c][j] = s;
        if (c == own) S.inverse[j] = 1.0f / s;
      }
      entry[i] = next[i];
    }
  }
  SYNC();
  EACH(i, PAIRS) {
    const int a = tree[PAIR + i] & 255, b = tree[PAIR + i] >> 8;
    float s = S.H_base[i], t = 0.0f;
    for (int k = 0; k < JOINTS; ++k) t += S.H[a][k] * S.inverse[k] * S.H[b][k];
    S.H_base[i] = s - t;
  }
  SYNC();
  float A[21];
  for (int i = 0; i < 21; ++i) A[i] = S.H_base[i];
  for (int i = 0; i < 6; ++i) base[i] = S.H_base[21 + i];
  solve_base(A, base);
  auto against_base = [&](int j) {
    float s = S.H[RHS][j];
    for (int c = 0; c < 6; ++c) s -= S.H[c][j] * base[c];
    return s * S.inverse[j];
  };
#if defined(__CUDA_ARCH__)  // as below, but all joints of a depth at once, by shuffles
  const int j = lane < JOINTS ? lane : JOINTS - 1, depth = tree[LEVEL + j];
  float s = against_base(j);
  for (int d = 0; d < DEPTH - 1; ++d) {
    const float x_up = __shfl_sync(0xFFFFFFFFu, s, above(d, j));
    if (d < depth - 1) s -= S.H[OWN + d][j] * S.inverse[j] * x_up;
  }
  S.step[j] = s;
#else
  for (int j = 0; j < JOINTS; ++j) {
    float s = against_base(j);
    for (int d = 0; d < tree[LEVEL + j] - 1; ++d) s -= S.H[OWN + d][j] * S.inverse[j] * S.step[above(d, j)];
    S.step[j] = s;
  }
#endif
  if (lane == 0)
    for (int c = 0; c < 6; ++c) S.step_base[c] = base[c];
  SYNC();
};

// the accelerations of the feet's links for the joints' x and the base's
auto feet_for = [&](const float* x, const float* base) {
  EACH(i, 6 * FEET) {
    const int f = i / 6, c = i % 6, j = tree[FOOT_LINK + f], depth = tree[LEVEL + j];
    float s = base[c];
    for (int d = 0; d < depth; ++d) {
      const int a = above(d, j);
      s += S.screw[c][a] * x[a];
    }
    S.foot[f][c] = s;
  }
};
// an edge's acceleration with them
auto edge_for = [&](int e) {
  const float* a = S.foot[tree[POINT_FOOT + e / 4]];
  float s = 0.0f;
  for (int c = 0; c < 6; ++c) s += S.edge[c][e] * a[c];
  return s;
};

#pragma unroll 1
for (int substep = 0; substep < substeps; ++substep) {
  // ---- kinematics: links put together by twos, fours, eights
  const mat33 R0 = wp::quat_to_matrix(rotation);
  const vec3 spin = mul(R0, turning);
  const vec3 lift = cross(lin, spin) - vec3(0.0f, 0.0f, gravity);  // acceleration without forces
  Row *pose = S.pose[0], *other = S.pose[1];
  SYNC();
  EACH(j, JOINTS) {
    const float half = 0.5f * (S.angle[j] - link(REF, j)), s = sinf(half), c = cosf(half);
    const vec3 axis = link3(AXIS, j) * s;
    const wp::quat fixed(link(TURN, j), link(TURN + 1, j), link(TURN + 2, j), link(TURN + 3, j));
    wp::quat turn = wp::mul(fixed, wp::quat(axis[0], axis[1], axis[2], c));
    vec3 where = link3(PLACE, j);
    if (tree[LEVEL + j] == 1) turn = wp::mul(rotation, turn), where = mul(R0, where);
    put3(pose, j, where), put4(pose + 3, j, turn);
  }
  SYNC();
  #pragma unroll 1
  for (int round = 0; round < ROUNDS; ++round) {
    EACH(j, JOINTS) {
      const int up = tree[UP + round * JOINTS + j];
      vec3 where = get3(pose, j);
      wp::quat turn = get4(pose + 3, j);
      if (up >= 0) {
        const wp::quat q_up = get4(pose + 3, up);
        where = get3(pose, up) + wp::quat_rotate(q_up, where), turn = wp::mul(q_up, turn);
      }
      put3(other, j, where), put4(other + 3, j, turn);
    }
    Row* last = pose;
    pose = other, other = last;
    SYNC();
  }
  EACH(j, JOINTS) {
    const vec3 axis = wp::quat_rotate(get4(pose + 3, j), link3(AXIS, j));
    put3(S.screw, j, cross(get3(pose, j), axis)), put3(S.screw + 3, j, axis);
  }
  const vec3 x_ang = mul(R0, x_ang_own);
  if (lane == 0) {
    put3(pose, JOINTS, vec3()), put4(pose + 3, JOINTS, rotation);
    for (int i = 0; i < 3; ++i) S.x_base[i] = x_lin[i], S.x_base[3 + i] = x_ang[i];
  }
  SYNC();

  // ---- velocities, forces without contacts, inertia (recursive Newton-Euler and composite bodies;
  // Featherstone 2008, tables 5.1 and 6.2)
  EACH(j, JOINTS) {
    const int depth = tree[LEVEL + j];
    vec3 u = lin, w = spin;
    for (int d = 0; d < depth; ++d) {
      const int a = above(d, j);
      u = u + get3(S.screw, a) * S.rate[a], w = w + get3(S.screw + 3, a) * S.rate[a];
    }
    put3(S.moving, j, u), put3(S.moving + 3, j, w);
    const vec3 arm = get3(S.screw, j), axis = get3(S.screw + 3, j);
    put3(S.turning, j, (cross(w, arm) + cross(u, axis)) * S.rate[j]);
    put3(S.turning + 3, j, cross(w, axis) * S.rate[j]);
  }
  SYNC();
  auto inertia_with = [&](int k, const mat33& R, vec3 where) {  // of the bodies of link k
    Inertia I = {0.0f, vec3(), mat33()};
    #pragma unroll 1
    for (int i = tree[BODY_FIRST + k]; i < tree[BODY_FIRST + k + 1]; ++i) {
      const float* b = number + BODY + i * 21;
      const int body = tree[BODY_ID + i];
      const vec3 at_centre = where + mul(R, read3(b) + mul(read33(b + 3), centre[body]));
      I.add(inertia_of(mass[body], moments[body], at_centre, mul(R, read33(b + 12))));
    }
    return I;
  };
  Row *sum = S.sum[0], *other_sum = S.sum[1];
  EACH(j, JOINTS) {
    const int depth = tree[LEVEL + j];
    vec3 al = lift, aa, moment, force;
    for (int d = 0; d < depth; ++d) {
      const int a = above(d, j);
      al = al + get3(S.turning, a), aa = aa + get3(S.turning + 3, a);
    }
    const Inertia I = inertia_with(j, wp::quat_to_matrix(get4(pose + 3, j)), get3(pose, j));
    momentum_rate(I, get3(S.moving + 3, j), get3(S.moving, j), aa, al, moment, force);
    put3(sum, j, force), put3(sum + 3, j, moment), sum[6][j] = I.m, put3(sum + 7, j, I.h);
    for (int a = 0; a < 3; ++a)
      for (int b = 0; b <= a; ++b) sum[10 + at(a, b)][j] = I.I.data[a][b];
  }
  SYNC();
  #pragma unroll 1
  for (int round = 0; round < ROUNDS; ++round) {  // as above, from the ends to the base
    EACH(j, JOINTS) {
      const int from = tree[DOWN_FIRST + round * JOINTS + j], end = tree[DOWN_FIRST + round * JOINTS + j + 1];
      float s[16];
      for (int c = 0; c < 16; ++c) s[c] = sum[c][j];
      #pragma unroll 1
      for (int i = from; i < end; ++i) {
        const int down = tree[DOWN + i];
        for (int c = 0; c < 16; ++c) s[c] += sum[c][down];
      }
      for (int c = 0; c < 16; ++c) other_sum[c][j] = s[c];
    }
    Row* last = sum;
    sum = other_sum, other_sum = last;
    SYNC();
  }
  auto inertia_below = [&](int j) {
    Inertia I = {sum[6][j], get3(sum + 7, j), mat33()};
    for (int a = 0; a < 3; ++a)
      for (int b = 0; b <= a; ++b) I.I.data[a][b] = I.I.data[b][a] = sum[10 + at(a, b)][j];
    return I;
  };
  Inertia whole = inertia_with(JOINTS, R0, vec3());
  vec3 base_moment, base_force;
  momentum_rate(whole, spin, lin, vec3(), lift, base_moment, base_force);
  #pragma unroll 1
  for (int i = 0; i < ROOTS; ++i) {
    const int j = tree[ROOT + i];
    whole.add(inertia_below(j));
    base_force = base_force + get3(sum, j), base_moment = base_moment + get3(sum + 3, j);
  }
  if (lane == 0) {
    const mat33 cross_h = skew(whole.h);
    for (int a = 0; a < 3; ++a) {
      for (int b = 0; b <= a; ++b) {
        S.M_base[at(a, b)] = a == b ? whole.m : 0.0f;
        S.M_base[at(a + 3, b + 3)] = whole.I.data[a][b];
      }
      for (int b = 0; b < 3; ++b) S.M_base[at(a + 3, b)] = cross_h.data[a][b];
      S.M_base[at(a, a)] += armature[a], S.M_base[at(a + 3, a + 3)] += armature[a + 3];
      S.M_base[21 + a] = -base_force[a], S.M_base[24 + a] = -base_moment[a];
    }
  }
  float trace = 0.0f;
  EACH(j, JOINTS) {
    const int depth = tree[LEVEL + j];
    const Inertia I = inertia_below(j);
    const vec3 arm = get3(S.screw, j), axis = get3(S.screw + 3, j);
    const vec3 force = I.force(axis, arm), moment = I.moment(axis, arm);
    put3(S.M, j, force), put3(S.M + 3, j, moment);
    for (int d = 0; d < depth; ++d) {
      const int a = above(d, j);
      const float m = dot(get3(S.screw, a), force) + dot(get3(S.screw + 3, a), moment);
      S.M[OWN + d][j] = d == depth - 1 ? m + armature[6 + j] : m;
    }
    trace += S.M[OWN - 1 + depth][j];
    // motors, friction and damping
    const float qd = S.rate[j], *p = motor_of + (motors == 1 ? 0 : j) * 8;
    const float wanted = target.data[(robot * substeps + substep) * JOINTS + j];
    const float t = motor_torque(p, wanted, S.angle[j], qd, S.torque[j]);
    S.torque[j] = t, S.before[j] = qd;
    S.M[RHS][j] = t - rubbing(p, qd) - link(DAMPING, j) * qd - dot(arm, get3(sum, j)) - dot(axis, get3(sum + 3, j));
    // joints beyond their range
    const float low = S.angle[j] - link(LOW, j), up = link(HIGH, j) - S.angle[j], over = wp::min(low, up);
    const float side = low < up ? 1.0f : -1.0f;
    S.side[j] = side, S.D[j] = S.aref[j] = 0.0f;
    if (over < 0.0f) {
      float k[8];
      for (int i = 0; i < 8; ++i) k[i] = link(LIMIT + i, j);
      const float imp = impedance(k, over);
      S.D[j] = stiffness(k[INVWEIGHT], imp);
      S.aref[j] = -k[B] * side * qd - k[K] * imp * over;
    }
  }
  const float scale = 1.0f / (total(trace) + 3.0f * whole.m + wp::trace(whole.I));

  // ---- contacts: four edges of a pyramid at each point of a foot (MuJoCo: mjc_PlaneSphere, mjc_PlaneCapsule,
  // mjc_PlaneBox)
#if GROUND
  auto end_of = [&](int p) {
    const int j = tree[FOOT_LINK + tree[POINT_FOOT + p]];
    return get3(pose, j) + wp::quat_rotate(get4(pose + 3, j), point3(PLACE, p));
  };
  EACH(p, POINTS) {
    vec3 up;
    S.depth[p] = nearest(ground, place + end_of(p), point(RADIUS, p), up) - point(RADIUS, p);
    for (int c = 0; c < 3; ++c) S.normal[p][c] = up[c];
  }
  SYNC();
#endif
  EACH(e, EDGES) {
#if GROUND
    const int p = e / 4, i = e % 4, j = tree[FOOT_LINK + tree[POINT_FOOT + p]];
    const float depth = S.depth[p];
    const vec3 up = read3(S.normal[p]), at_point = end_of(p) - up * (point(RADIUS, p) + 0.5f * depth);
    vec3 way, other_way;
    tangents(up, way, other_way);
    if (i > 1) way = other_way;
#else
    const int p = e / 4, i = e % 4, j = tree[FOOT_LINK + tree[POINT_FOOT + p]], kind = tree[POINT_KIND + p];
    const vec3 up(0.0f, 0.0f, 1.0f);
    const wp::quat turn = get4(pose + 3, j);
    vec3 at_point = get3(pose, j) + wp::quat_rotate(turn, point3(PLACE, p)), way(1.0f, 0.0f, 0.0f);
    if (kind != SPHERE) {
      const vec3 more = wp::quat_rotate(turn, point3(MORE, p));
      const float flat = sqrtf(more[0] * more[0] + more[1] * more[1]);
      if (kind == BOX) at_point = at_point + (more[2] > 0.0f ? -more : more);  // of opposite corners the lower
      else if (flat > 0.0f) way = vec3(more[0] / flat, more[1] / flat, 0.0f);
    }
    if (i > 1) way = vec3(-way[1], way[0], 0.0f);
    const float depth = place[2] + at_point[2] - point(RADIUS, p);
    at_point[2] -= point(RADIUS, p) + 0.5f * depth;
#endif
    const float mu = wp::max(rub[tree[POINT_GEOM + p]][0], 1e-5f);
    const vec3 force = up + way * (i % 2 ? -mu : mu), moment = cross(at_point, force);
    float speed = 0.0f;
    for (int c = 0; c < 3; ++c) {
      S.edge[c][e] = force[c], S.edge[3 + c][e] = moment[c];
      speed += force[c] * S.moving[c][j] + moment[c] * S.moving[3 + c][j];
    }
    S.edge_D[e] = S.edge_aref[e] = 0.0f;
    if (depth < 0.0f) {
      float k[8];
      for (int f = 0; f < 8; ++f) k[f] = point(CONTACT + f, p);
      const float imp = impedance(k, depth), mu2 = mu * mu;
      S.edge_D[e] = stiffness(k[INVWEIGHT] * (1.0f + mu2) * 2.0f * mu2, imp);
      S.edge_aref[e] = -k[B] * speed - k[K] * imp * depth;
    }
#if !GROUND
    if (i == 0) S.depth[p] = depth;
#endif
  }
  SYNC();
  // timers, as of the positions at the start of the physics step (engine.py)
  EACH(f, FEET) {
    float height = 1e30f;
    #pragma unroll 1
    for (int p = tree[POINT_FIRST + f]; p < tree[POINT_FIRST + f + 1]; ++p)
      if (!(S.depth[p] >= height)) height = S.depth[p];  // not `min`, which would lose what is no number
    const int foot = robot * FEET + tree[FOOT_ID + f];
    int& air = air_steps.data[foot];
    float& high = peak.data[foot];
    const bool down = height < 0.0f;
    if (down && air > 0) last_air_steps.data[foot] = air + 1, last_peak.data[foot] = high;
    air = down ? 0 : air + 1;
    contact_steps.data[foot] = down ? contact_steps.data[foot] + 1 : 0;
    if (down) high = 0.0f;
    else if (!(height <= high)) high = height;
  }
  const bool every = flag;  // parts in every physics step, not only in the last
  if (every || substep == substeps - 1)
    EACH(i, PARTS) {
      const int j = tree[PART_LINK + i];
      const mat33 R = wp::quat_to_matrix(get4(pose + 3, j));
#if GROUND
      float low = 1e30f;
      #pragma unroll 1
      for (int k = tree[PROBE_FIRST + i]; k < tree[PROBE_FIRST + i + 1]; ++k) {
        const float height = probe_above(ground, parts.data + k * PART, R, place + get3(pose, j));
        if (!(height >= low)) low = height;
      }
#else
      const float* g = parts.data + i * PART;
      const float low = place[2] + pose[2][j] + lowest_point(g, R);
#endif
      float& lowest_yet = lowest.data[robot * PARTS + i];
      if (!every || substep == 0 || !(low >= lowest_yet)) lowest_yet = low;
    }

  // ---- Newton's method for the accelerations x (MuJoCo's primal problem: computation.html,
  // "the constraint solver"), exact line search
  #pragma unroll 1
  for (int round = 0; round < rounds; ++round) {
    feet_for(S.x, S.x_base);
    SYNC();
    EACH(e, EDGES) {
      const float jar = edge_for(e) - S.edge_aref[e];
      S.edge_jar[e] = jar, S.edge[6][e] = -jar;
      S.edge_on[e] = jar < 0.0f ? S.edge_D[e] : 0.0f;
    }
    SYNC();
    EACH(i, PAIRS * FEET) {
      const int f = i / PAIRS, pair = tree[PAIR + i % PAIRS], a = pair & 255, b = pair >> 8;
      float s = 0.0f;
      for (int e = 4 * tree[POINT_FIRST + f]; e < 4 * tree[POINT_FIRST + f + 1]; ++e)
        s += S.edge_on[e] * S.edge[a][e] * S.edge[b][e];
      S.pull[f][i % PAIRS] = s;
    }
    SYNC();
    EACH(j, JOINTS) {
      const int depth = tree[LEVEL + j], from = tree[FOOT_FIRST + j], end = tree[FOOT_END + j];
      const float jar = S.side[j] * S.x[j] - S.aref[j], stop = jar < 0.0f ? S.D[j] : 0.0f;
      S.jar[j] = jar;
      float g = times(j) - S.M[RHS][j] + S.side[j] * stop * jar, F[6] = {};  // F: the feet's pull by the joint
      #pragma unroll 1
      for (int f = from; f < end; ++f)
        for (int a = 0; a < 6; ++a) {
          g -= S.screw[a][j] * S.pull[f][21 + a];
          for (int b = 0; b < 6; ++b) F[a] += S.pull[f][b < a ? at(a, b) : at(b, a)] * S.screw[b][j];
        }
      S.grad[j] = S.H[RHS][j] = g;
      for (int c = 0; c < 6; ++c) S.H[c][j] = S.M[c][j] + F[c];
      for (int d = 0; d < depth; ++d) {
        float s = S.M[OWN + d][j];
        if (from < end) {
          const int up = above(d, j);
          for (int c = 0; c < 6; ++c) s += S.screw[c][up] * F[c];
        }
        S.H[OWN + d][j] = d == depth - 1 ? s + stop : s;
      }
    }
    EACH(i, PAIRS) {
      float s = i < 21 ? S.M_base[i] : times_base(i - 21) - S.M_base[i];
      #pragma unroll 1
      for (int f = 0; f < FEET; ++f) s += i < 21 ? S.pull[f][i] : -S.pull[f][i];
      S.H_base[i] = s;
    }
    float grad[6], step[6];
    SYNC();
    for (int c = 0; c < 6; ++c) grad[c] = S.H_base[21 + c];
    solve(step);  // x - step: the minimum?

    // along the step: the cost's slope is that of the smooth part, and of each constraint that holds
    feet_for(S.step, S.step_base);
    SYNC();
    float downhill = 0.0f, held = 0.0f, held_slope = 0.0f;
    EACH(j, JOINTS) {
      const float jar = S.jar[j], stop = jar < 0.0f ? S.D[j] : 0.0f, along = S.side[j] * S.step[j];
      downhill += S.grad[j] * S.step[j];
      held += stop * along * along, held_slope += stop * along * jar;
    }
    EACH(e, EDGES) {
      const float along = edge_for(e), on = S.edge_on[e];
      S.along[e] = along;
      held += on * along * along, held_slope += on * along * S.edge_jar[e];
    }
    downhill = total(downhill);
    for (int c = 0; c < 6; ++c) downhill += grad[c] * step[c];
    if (0.5f * scale * downhill < tolerance) break;
    const float curve = downhill - total(held), slope = total(held_slope) - downhill;
    float alpha = 1.0f, low = 0.0f, up = -1.0f;
    #pragma unroll 1
    for (int search = 0; search < line_rounds; ++search) {
      float s = 0.0f, c = 0.0f;  // of the constraints: slope and curvature at x - alpha step
      EACH(e, EDGES) {
        const float along = S.along[e], r = S.edge_jar[e] - alpha * along, on = r < 0.0f ? S.edge_D[e] : 0.0f;
        s -= on * along * r, c += on * along * along;
      }
      EACH(j, JOINTS) {
        const float along = S.side[j] * S.step[j], r = S.jar[j] - alpha * along, on = r < 0.0f ? S.D[j] : 0.0f;
        s -= on * along * r, c += on * along * along;
      }
      s = total(s) + slope + alpha * curve, c = total(c) + curve;
      if (fabsf(s) < 1e-3f * downhill) break;
      (s < 0.0f ? low : up) = alpha;
      alpha -= s / c;
      if (alpha <= low || (up > 0.0f && alpha >= up)) alpha = up > 0.0f ? 0.5f * (low + up) : 2.0f * low;
    }
    SYNC();
    EACH(j, JOINTS) S.x[j] -= alpha * S.step[j];
    if (lane == 0)
      for (int c = 0; c < 6; ++c) S.x_base[c] -= alpha * step[c];
    SYNC();
  }

  // ---- semi-implicit Euler; the joints' damping implicitly, as MuJoCo does it
  SYNC();
  x_lin = read3(S.x_base), x_ang_own = mul(wp::transpose(R0), read3(S.x_base + 3));
  vec3 a_lin = x_lin, a_ang = x_ang_own;
  const float* a = S.x;
  if (DAMPED) {
    EACH(j, JOINTS) {
      const int depth = tree[LEVEL + j];
      for (int c = 0; c < 6; ++c) S.H[c][j] = S.M[c][j];
      for (int d = 0; d < depth; ++d) S.H[OWN + d][j] = S.M[OWN + d][j];
      S.H[OWN - 1 + depth][j] += h * link(DAMPING, j);
      S.H[RHS][j] = times(j);
    }
    EACH(i, PAIRS) S.H_base[i] = i < 21 ? S.M_base[i] : times_base(i - 21);
    float base[6];
    solve(base);
    a = S.step, a_lin = read3(base), a_ang = mul(wp::transpose(R0), read3(base + 3));
  }
  lin = lin + a_lin * h, turning = turning + a_ang * h;
  place = place + lin * h;
  const float most = wp::length(turning), half = 0.5f * h * most;
  const vec3 way = most > 0.0f ? turning * (sinf(half) / most) : vec3();
  rotation = wp::normalize(wp::mul(rotation, wp::quat(way[0], way[1], way[2], cosf(half))));
  EACH(j, JOINTS) S.rate[j] += h * a[j], S.angle[j] += h * S.rate[j];
}

// ---- what is there after
if (lane == 0)
  for (int i = 0; i < 3; ++i) {
    q[i] = place[i], q[4 + i] = rotation[i], q[3] = rotation[3];
    v[i] = lin[i], v[3 + i] = turning[i], warm[i] = x_lin[i], warm[3 + i] = x_ang_own[i];
  }
EACH(j, JOINTS) {
  q[7 + j] = S.angle[j], v[6 + j] = S.rate[j], warm[6 + j] = S.x[j];
  torque.data[robot * JOINTS + j] = S.torque[j];
  qd_before.data[robot * JOINTS + j] = S.before[j];
}
#undef EACH
#undef SYNC
#undef SHARED
