// The third part of the function of quadruped.py: a control step of a quadruped that keeps the contract
// (contract.py), with its feet on a plane, or (GROUND) on a height map.
//
// On a height map each foot has one contact, with the nearest triangle, and its normal and tangents; MuJoCo's
// own has one more for every other triangle that the sphere reaches (docs/terrain.md, Contacts, on why not here).
// A plane's are the world's axes.
#if GROUND
#define IN_FRAME(l, u) mul(frame[l], u)
#define IN_WORLD(l, F) mul(wp::transpose(frame[l]), F)
#define TURNED(l, W) mul(wp::transpose(frame[l]), mul(W, frame[l]))
#else
#define IN_FRAME(l, u) (u)
#define IN_WORLD(l, F) (F)
#define TURNED(l, W) (W)
#endif

// ---- what is there before
float* q = qpos.data + robot * 19;
float* v = qvel.data + robot * 18;
float* warm = qacc_warmstart.data + robot * 18;
// the motors' numbers: one row for all joints of a robot, or a row a joint
const int motors = motor.shape[1];
const float* motor_of = motor.data + robot * motors * 8;
// rows of the bodies, one for all robots or one a robot; the world is body 0
auto row = [&](int rows) { return rows == 1 ? 0 : robot; };
const float* mass = body_mass.data + row(body_mass.shape[0]) * 14;
const vec3* moments = body_inertia.data + row(body_inertia.shape[0]) * 14;
const vec3* centre = body_ipos.data + row(body_ipos.shape[0]) * 14;
const vec3* rub = geom_friction.data + row(geom_friction.shape[0]) * geom_friction.shape[1];
const float* armature = dof_armature.data + row(dof_armature.shape[0]) * 18;
const float* base_k = numbers.data;
const float h = base_k[TIMESTEP], gravity = base_k[GRAVITY], tolerance = base_k[TOLERANCE];

vec3 place = read3(q), lin = read3(v), turning = read3(v + 3);  // turning: in the base's axes
wp::quat rotation = wp::normalize(wp::quat(q[4], q[5], q[6], q[3]));
vec3 x_lin = read3(warm), x_ang_own = read3(warm + 3);
float angle[LEGS][3], rate[LEGS][3], torque_is[LEGS][3], before[LEGS][3], x[LEGS][3];
int air[LEGS], touch[LEGS], last_air[LEGS];
float high[LEGS], last_high[LEGS];
for (int l = 0; l < LEGS; ++l) {
  const int leg = leg0 + l, foot = robot * 4 + leg;
  for (int k = 0; k < 3; ++k) {
    const int joint = leg * 3 + k;
    angle[l][k] = q[7 + joint], rate[l][k] = v[6 + joint], x[l][k] = warm[6 + joint];
    torque_is[l][k] = torque.data[robot * 12 + joint];
  }
  air[l] = air_steps.data[foot], touch[l] = contact_steps.data[foot];
  last_air[l] = last_air_steps.data[foot];
  high[l] = peak.data[foot], last_high[l] = last_peak.data[foot];
}
#if GROUND
const float* const ground = base_k + MAP;
mat33 frame[LEGS];  // of a foot's contact: rows are its tangents and its normal
auto keep_probe = [&](const float* g, mat33 R, vec3 where) {  // of a part (contacts.Probes)
  float& yet = lowest.data[robot * lowest.shape[1] + (int)g[8]];
  const float height = probe_above(ground, g, R, where);
  if (g[9] > 0.0f || !(height >= yet)) yet = height;  // the part's first, or lower, or no number
};
#endif

for (int substep = 0; substep < substeps; ++substep) {
  // ---- kinematics, velocities, forces without contacts, inertia (recursive Newton-Euler and
  // composite bodies; Featherstone 2008, tables 5.1 and 6.2)
  const mat33 R0 = wp::quat_to_matrix(rotation);
  const vec3 spin = mul(R0, turning);
  const vec3 lift = cross(lin, spin) - vec3(0.0f, 0.0f, gravity);  // acceleration without forces
  const Inertia trunk = inertia_of(mass[1], moments[1], mul(R0, centre[1]), mul(R0, read33(base_k + TRUNK)));
  vec3 smooth_ang, smooth_lin;
  momentum_rate(trunk, spin, lin, vec3(), lift, smooth_ang, smooth_lin);
  Inertia whole = {0.0f, vec3(), mat33()};
  vec3 legs_moment, legs_force;

  Leg M[LEGS];
  vec3 axis[LEGS][3], J[LEGS][3], at_foot[LEGS], slip[LEGS];  // J: the foot's velocity by a joint's
  float smooth[LEGS][3], depth[LEGS], D_foot[LEGS], aref[LEGS][4], mu[LEGS];
  float D_joint[LEGS][3], aref_joint[LEGS][3], side[LEGS][3], damping[LEGS][3];
  for (int l = 0; l < LEGS; ++l) {
    const int leg = leg0 + l, foot = robot * 4 + leg;
    Inertia link[3];
    vec3 arm[3], moment[3], force[3];
    mat33 R = R0;
    vec3 where, w = spin, u = lin, aa, al = lift;
    for (int k = 0; k < 3; ++k) {
      const int body = 2 + leg * 3 + k;
      const float* c = base_k + LINKS + (leg * 3 + k) * LINK;
      where = where + mul(R, read3(c + PLACE));
      const vec3 a = axis[l][k] = mul(R, read3(c + AXIS));
      arm[k] = cross(where, a);
      R = mul(R, about(read3(c + AXIS), angle[l][k]));
      link[k] = inertia_of(mass[body], moments[body], where + mul(R, centre[body]), mul(R, read33(c + TURN)));
      const float qd = rate[l][k];
      al = al + (cross(w, arm[k]) + cross(u, a)) * qd, aa = aa + cross(w, a) * qd;
      w = w + a * qd, u = u + arm[k] * qd;
      momentum_rate(link[k], w, u, aa, al, moment[k], force[k]);
      // joints beyond their range
      const float low = angle[l][k] - c[LOW], up = c[HIGH] - angle[l][k];
      side[l][k] = low < up ? 1.0f : -1.0f;
      const float over = wp::min(low, up), imp = impedance(c + LIMIT, over);
      D_joint[l][k] = over < 0.0f ? stiffness(c[LIMIT + INVWEIGHT], imp) : 0.0f;
      aref_joint[l][k] = -c[LIMIT + B] * side[l][k] * qd - c[LIMIT + K] * imp * over;
      damping[l][k] = c[DAMPING];
      if (substep == substeps - 1)  // the lowest points of the link's other parts (contacts.py)
        for (int i = tables.data[body]; i < tables.data[body + 1]; ++i) {
          const float* g = parts.data + i * PART;
#if GROUND
          keep_probe(g, R, place + where);
#else
          lowest.data[robot * lowest.shape[1] + (int)g[17]] = place[2] + where[2] + lowest_point(g, R);
#endif
        }
    }
    const float* f = base_k + FEET + leg * FOOT;
    at_foot[l] = where + mul(R, read3(f));
#if GROUND
    vec3 up, one, two;
    depth[l] = nearest(ground, place + at_foot[l], f[RADIUS], up) - f[RADIUS];
    tangents(up, one, two);
    frame[l] = mat33(one[0], one[1], one[2], two[0], two[1], two[2], up[0], up[1], up[2]);
#else
    depth[l] = place[2] + at_foot[l][2] - f[RADIUS];
#endif
    // timers, as of the positions at the start of the physics step (engine.py)
    const bool down = depth[l] < 0.0f;
    if (down && air[l] > 0) last_air[l] = air[l] + 1, last_high[l] = high[l];
    air[l] = down ? 0 : air[l] + 1;
    touch[l] = down ? touch[l] + 1 : 0;
    if (down) high[l] = 0.0f;
    else if (!(depth[l] <= high[l])) high[l] = depth[l];
#if GROUND
    at_foot[l] = at_foot[l] - up * (f[RADIUS] + 0.5f * depth[l]);  // the point of contact
#else
    at_foot[l][2] -= f[RADIUS] + 0.5f * depth[l];  // the point of contact
#endif
    slip[l] = lin + cross(spin, at_foot[l]);
    for (int k = 0; k < 3; ++k) {
      J[l][k] = arm[k] + cross(axis[l][k], at_foot[l]);
      slip[l] = slip[l] + J[l][k] * rate[l][k];
    }
    slip[l] = IN_FRAME(l, slip[l]);
    mu[l] = wp::max(rub[(int)f[GEOM]][0], 1e-5f);
    const float imp = impedance(f + CONTACT, depth[l]), mu2 = mu[l] * mu[l];
    const float weight = f[CONTACT + INVWEIGHT] * (1.0f + mu2) * 2.0f * mu2;
    D_foot[l] = down ? stiffness(weight, imp) : 0.0f;
    for (int i = 0; i < 4; ++i) {
      const float along = slip[l][2] + (i % 2 ? -mu[l] : mu[l]) * slip[l][i / 2];
      aref[l][i] = -f[CONTACT + B] * along - f[CONTACT + K] * imp * depth[l];
    }
    for (int k = 2; k >= 0; --k) {
      const float qd = rate[l][k];
      const float* p = motor_of + (motors == 1 ? 0 : leg * 3 + k) * 8;
      const float wanted = target.data[(robot * substeps + substep) * 12 + leg * 3 + k];
      const float t = motor_torque(p, wanted, angle[l][k], qd, torque_is[l][k]);
      torque_is[l][k] = t, before[l][k] = qd;
      // from the foot to the base: forces, and the inertia of what hangs on each joint
      if (k < 2) moment[k] = moment[k] + moment[k + 1], force[k] = force[k] + force[k + 1], link[k].add(link[k + 1]);
      const float rubs = rubbing(p, qd) + damping[l][k] * qd;
      smooth[l][k] = t - rubs - dot(axis[l][k], moment[k]) - dot(arm[k], force[k]);
      M[l].ang[k] = link[k].moment(axis[l][k], arm[k]), M[l].lin[k] = link[k].force(axis[l][k], arm[k]);
      for (int j = 0; j <= k; ++j)
        M[l].own[at(k, j)] = dot(axis[l][j], M[l].ang[k]) + dot(arm[j], M[l].lin[k]);
      M[l].own[at(k, k)] += armature[6 + leg * 3 + k];
    }
    legs_moment = legs_moment + moment[0], legs_force = legs_force + force[0];
    whole.add(link[0]);
  }
  if (substep == substeps - 1 && leg0 == 0)
    for (int i = tables.data[1]; i < tables.data[2]; ++i) {
      const float* g = parts.data + i * PART;
#if GROUND
      keep_probe(g, R0, place);
#else
      lowest.data[robot * lowest.shape[1] + (int)g[17]] = place[2] + lowest_point(g, R0);
#endif
    }
  smooth_ang = -(smooth_ang + total3(legs_moment)), smooth_lin = -(smooth_lin + total3(legs_force));
  whole.m = total(whole.m), whole.h = total3(whole.h);
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j <= i; ++j) whole.I.data[i][j] = whole.I.data[j][i] = total(whole.I.data[i][j]);
  whole.add(trunk);
  float M_base[21];
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j <= i; ++j) {
      M_base[at(i, j)] = i == j ? whole.m : 0.0f;
      M_base[at(i + 3, j + 3)] = whole.I.data[i][j];
    }
  const mat33 H = skew(whole.h);
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) M_base[at(i + 3, j)] = H.data[i][j];
  float trace = 3.0f * whole.m + wp::trace(whole.I), own_trace = 0.0f;
  for (int l = 0; l < LEGS; ++l) own_trace += M[l].own[0] + M[l].own[2] + M[l].own[5];
  const float scale = 1.0f / (trace + total(own_trace));

  // ---- Newton's method for the accelerations x (MuJoCo's primal problem: computation.html, 
  // "the constraint solver"), exact line search
  vec3 x_ang = mul(R0, x_ang_own);
  auto times_base = [&](vec3 ang, vec3 lin_, vec3& moment, vec3& force) {
    moment = whole.moment(ang, lin_), force = whole.force(ang, lin_);
  };
  for (int round = 0; round < rounds; ++round) {
    Leg hess[LEGS];
    float hess_base[21], grad[LEGS][3], step[LEGS][3], jar[LEGS][4], jar_joint[LEGS][3];
    vec3 grad_ang, grad_lin, step_ang, step_lin;
    for (int i = 0; i < 21; ++i) hess_base[i] = 0.0f;
    for (int l = 0; l < LEGS; ++l) {
      vec3 u = x_lin + cross(x_ang, at_foot[l]);
      for (int k = 0; k < 3; ++k) u = u + J[l][k] * x[l][k];
      u = IN_FRAME(l, u);
      float f[4], on[4];  // forces along the edges of the pyramid, and their stiffnesses
      for (int i = 0; i < 4; ++i) {
        jar[l][i] = u[2] + (i % 2 ? -mu[l] : mu[l]) * u[i / 2] - aref[l][i];
        on[i] = jar[l][i] < 0.0f ? D_foot[l] : 0.0f;
        f[i] = -on[i] * jar[l][i];
      }
      const float m1 = mu[l], m2 = mu[l] * mu[l];
      const vec3 F = IN_WORLD(l, vec3(m1 * (f[0] - f[1]), m1 * (f[2] - f[3]), f[0] + f[1] + f[2] + f[3]));
      const float xz = m1 * (on[0] - on[1]), yz = m1 * (on[2] - on[3]);
      const mat33 W = TURNED(l, mat33(m2 * (on[0] + on[1]), 0.0f, xz, 0.0f, m2 * (on[2] + on[3]), yz, xz, yz,
                                      on[0] + on[1] + on[2] + on[3]));
      hess[l] = M[l];
      grad_ang = grad_ang - cross(at_foot[l], F), grad_lin = grad_lin - F;
      for (int k = 0; k < 3; ++k) {
        jar_joint[l][k] = side[l][k] * x[l][k] - aref_joint[l][k];
        const float stop = jar_joint[l][k] < 0.0f ? D_joint[l][k] : 0.0f;
        float g = dot(M[l].ang[k], x_ang) + dot(M[l].lin[k], x_lin) - smooth[l][k] - dot(J[l][k], F) +
                  side[l][k] * stop * jar_joint[l][k];
        for (int j = 0; j < 3; ++j) g += M[l].own[j < k ? at(k, j) : at(j, k)] * x[l][j];
        grad[l][k] = g;
        grad_ang = grad_ang + M[l].ang[k] * x[l][k], grad_lin = grad_lin + M[l].lin[k] * x[l][k];
        const vec3 Z = mul(W, J[l][k]);
        for (int j = 0; j <= k; ++j) hess[l].own[at(k, j)] += dot(Z, J[l][j]);
        hess[l].own[at(k, k)] += stop;
        hess[l].lin[k] = hess[l].lin[k] + Z, hess[l].ang[k] = hess[l].ang[k] + cross(at_foot[l], Z);
      }
      const mat33 S = skew(at_foot[l]), SW = mul(S, W), SWS = mul(SW, wp::transpose(S));
      for (int i = 0; i < 3; ++i) {
        for (int j = 0; j <= i; ++j) {
          hess_base[at(i, j)] += W.data[i][j];
          hess_base[at(i + 3, j + 3)] += SWS.data[i][j];
        }
        for (int j = 0; j < 3; ++j) hess_base[at(i + 3, j)] += SW.data[i][j];
      }
    }
    for (int i = 0; i < 21; ++i) hess_base[i] = M_base[i] + total(hess_base[i]);
    vec3 moment, force;
    times_base(x_ang, x_lin, moment, force);
    grad_ang = total3(grad_ang) + moment - smooth_ang, grad_lin = total3(grad_lin) + force - smooth_lin;
    solve(hess, hess_base, grad, grad_lin, grad_ang, step, step_lin, step_ang);  // x - step: the minimum?

    // along the step: the cost's slope is that of the smooth part, and of each constraint that holds
    float edge[LEGS][4], downhill = 0.0f, held = 0.0f, held_slope = 0.0f;
    for (int l = 0; l < LEGS; ++l) {
      vec3 u = step_lin + cross(step_ang, at_foot[l]);
      for (int k = 0; k < 3; ++k) {
        u = u + J[l][k] * step[l][k], downhill += grad[l][k] * step[l][k];
        const float stop = jar_joint[l][k] < 0.0f ? D_joint[l][k] : 0.0f, e = side[l][k] * step[l][k];
        held += stop * e * e, held_slope += stop * e * jar_joint[l][k];
      }
      u = IN_FRAME(l, u);
      for (int i = 0; i < 4; ++i) {
        edge[l][i] = u[2] + (i % 2 ? -mu[l] : mu[l]) * u[i / 2];
        const float on = jar[l][i] < 0.0f ? D_foot[l] : 0.0f;
        held += on * edge[l][i] * edge[l][i], held_slope += on * edge[l][i] * jar[l][i];
      }
    }
    downhill = total(downhill) + dot(grad_ang, step_ang) + dot(grad_lin, step_lin);
    if (0.5f * scale * downhill < tolerance) break;
    const float curve = downhill - total(held), slope = total(held_slope) - downhill;
    float alpha = 1.0f, low = 0.0f, up = -1.0f;
    for (int search = 0; search < line_rounds; ++search) {
      float s = 0.0f, c = 0.0f;  // of the constraints: slope and curvature at x - alpha step
      for (int l = 0; l < LEGS; ++l) {
        for (int i = 0; i < 4; ++i) {
          const float r = jar[l][i] - alpha * edge[l][i], on = r < 0.0f ? D_foot[l] : 0.0f;
          s -= on * edge[l][i] * r, c += on * edge[l][i] * edge[l][i];
        }
        for (int k = 0; k < 3; ++k) {
          const float e = side[l][k] * step[l][k], r = jar_joint[l][k] - alpha * e;
          const float on = r < 0.0f ? D_joint[l][k] : 0.0f;
          s -= on * e * r, c += on * e * e;
        }
      }
      s = total(s) + slope + alpha * curve, c = total(c) + curve;
      if (fabsf(s) < 1e-3f * downhill) break;
      (s < 0.0f ? low : up) = alpha;
      alpha -= s / c;
      if (alpha <= low || (up > 0.0f && alpha >= up)) alpha = up > 0.0f ? 0.5f * (low + up) : 2.0f * low;
    }
    x_ang = x_ang - step_ang * alpha, x_lin = x_lin - step_lin * alpha;
    for (int l = 0; l < LEGS; ++l)
      for (int k = 0; k < 3; ++k) x[l][k] -= alpha * step[l][k];
  }

  // ---- semi-implicit Euler; the joints' damping implicitly, as MuJoCo does it
  x_ang_own = mul(wp::transpose(R0), x_ang);
  vec3 a_lin = x_lin, a_ang = x_ang_own;
  float a[LEGS][3];
  for (int l = 0; l < LEGS; ++l)
    for (int k = 0; k < 3; ++k) a[l][k] = x[l][k];
  if (flag) {  // joints with damping
    float force[LEGS][3];
    Leg held[LEGS];
    vec3 ang, lin_, base_ang, base_lin;
    for (int l = 0; l < LEGS; ++l) {
      held[l] = M[l];
      for (int k = 0; k < 3; ++k) {
        force[l][k] = dot(M[l].ang[k], x_ang) + dot(M[l].lin[k], x_lin);
        for (int j = 0; j < 3; ++j) force[l][k] += M[l].own[j < k ? at(k, j) : at(j, k)] * x[l][j];
        ang = ang + M[l].ang[k] * x[l][k], lin_ = lin_ + M[l].lin[k] * x[l][k];
        held[l].own[at(k, k)] += h * damping[l][k];
      }
    }
    times_base(x_ang, x_lin, base_ang, base_lin);
    vec3 world;
    solve(held, M_base, force, total3(lin_) + base_lin, total3(ang) + base_ang, a, a_lin, world);
    a_ang = mul(wp::transpose(R0), world);
  }
  lin = lin + a_lin * h, turning = turning + a_ang * h;
  place = place + lin * h;
  const float most = wp::length(turning), half = 0.5f * h * most;
  const vec3 way = most > 0.0f ? turning * (sinf(half) / most) : vec3();
  rotation = wp::normalize(wp::mul(rotation, wp::quat(way[0], way[1], way[2], cosf(half))));
  for (int l = 0; l < LEGS; ++l)
    for (int k = 0; k < 3; ++k) rate[l][k] += h * a[l][k], angle[l][k] += h * rate[l][k];
}

// ---- what is there after
if (leg0 == 0)
  for (int i = 0; i < 3; ++i) {
    q[i] = place[i], q[4 + i] = rotation[i], q[3] = rotation[3];
    v[i] = lin[i], v[3 + i] = turning[i], warm[i] = x_lin[i], warm[3 + i] = x_ang_own[i];
  }
for (int l = 0; l < LEGS; ++l) {
  const int leg = leg0 + l, foot = robot * 4 + leg;
  for (int k = 0; k < 3; ++k) {
    const int joint = leg * 3 + k;
    q[7 + joint] = angle[l][k], v[6 + joint] = rate[l][k], warm[6 + joint] = x[l][k];
    torque.data[robot * 12 + joint] = torque_is[l][k];
    qd_before.data[robot * 12 + joint] = before[l][k];
  }
  air_steps.data[foot] = air[l], contact_steps.data[foot] = touch[l];
  last_air_steps.data[foot] = last_air[l];
  peak.data[foot] = high[l], last_peak.data[foot] = last_high[l];
}
#undef IN_FRAME
#undef IN_WORLD
#undef TURNED
