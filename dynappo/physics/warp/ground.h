// Ground that is not flat, of the kernels that have it (GROUND): heights on a grid, two triangles a cell, as
// terrain/height_map.py, which says what each function is. Behind algebra.h.
//
// `ground` points to arrays.map_numbers: cell, corner, X, Y, then heights [X, Y]. Places are in the world.
struct Below {  // of a place: its cell, what of the cell is before it (m), and the cell's first height
  int i, j;
  float x, y, z;
  const float* h;  // of the cell's first corner, the next along x `wide` further
};
auto below = [&](const float* ground, float x, float y) {
  const float cell = ground[0];
  const int X = (int)ground[3], Y = (int)ground[4];
  // a place that is no number is at the first corner: compared so
  x -= ground[1], y -= ground[2];
  const float far_x = cell * (X - 1), far_y = cell * (Y - 1);
  x = x > 0.0f ? (x < far_x ? x : far_x) : 0.0f, y = y > 0.0f ? (y < far_y ? y : far_y) : 0.0f;
  Below b = {wp::min((int)(x / cell), X - 2), wp::min((int)(y / cell), Y - 2), x, y, 0.0f, nullptr};
  b.h = ground + 5 + b.i * Y + b.j;
  const float s = x - b.i * cell, t = y - b.j * cell, z00 = b.h[0], z11 = b.h[Y + 1];
  const float mid = s >= t ? b.h[Y] : b.h[1];
  const float most = wp::max(s, t), least = wp::min(s, t);
  b.z = z00 + ((mid - z00) * most + (z11 - mid) * least) / cell;
  return b;
};

// Distance from the plane of the triangle below (height_map.gap), without the radius.
auto above_ground = [&](const float* ground, vec3 p) {
  const Below b = below(ground, p[0], p[1]);
  const float cell = ground[0];
  const int Y = (int)ground[4];
  const float mid = b.x - b.i * cell >= b.y - b.j * cell ? b.h[Y] : b.h[1];
  const float a = mid - b.h[0], c = b.h[Y + 1] - mid;
  return (p[2] - b.z) * cell / sqrtf(cell * cell + a * a + c * c);
};

// Distance of the nearest point, and the normal there (height_map.nearest).
auto nearest = [&](const float* ground, vec3 p, float radius, vec3& normal) {
  const Below b = below(ground, p[0], p[1]);
  const float cell = ground[0], sign = p[2] >= b.z ? 1.0f : -1.0f;
  const int X = (int)ground[3], Y = (int)ground[4];
  const float* const heights = ground + 5;
  auto cell_of = [&](float x, int most) { return wp::min(wp::max((int)floorf(x / cell), 0), most); };
  const int i0 = cell_of(b.x - radius, X - 2), i1 = cell_of(b.x + radius, X - 2);
  const int j0 = cell_of(b.y - radius, Y - 2), j1 = cell_of(b.y + radius, Y - 2);
  // the nearest yet: its square, and the way from p to it; on a plane, that plane's normal
  float best = 1e30f;
  vec3 way(0.0f, 0.0f, -1.0f), plane;
  bool on_edge_yet = true;
  auto on_plane = [&](vec3 n, vec3 a, bool upper) {
    const float above = -dot(n, a), share = above / dot(n, n), square = above * share;
    const float u = -(share * n[0] + a[0]), v = -(share * n[1] + a[1]);
    const float low = upper ? u : v, high = upper ? v : u;
    if (low >= 0.0f && low <= high && high <= cell && square < best)
      best = square, way = n * -share, plane = n, on_edge_yet = false;
  };
  auto on_edge = [&](vec3 a, vec3 e) {
    const float t = -dot(a, e) / dot(e, e);
    const vec3 q = a + e * wp::min(wp::max(t, 0.0f), 1.0f);
    const float square = dot(q, q);
    if (square < best) best = square, way = q, on_edge_yet = true;
  };
  #pragma unroll 1
  for (int i = i0; i <= i1; ++i)
    #pragma unroll 1
    for (int j = j0; j <= j1; ++j) {
      const float *h = heights + i * Y + j, z00 = h[0], z01 = h[1], z10 = h[Y], z11 = h[Y + 1];
      const vec3 v00(i * cell - b.x, j * cell - b.y, z00 - p[2]);  // seen from p
      const vec3 v11 = v00 + vec3(cell, cell, z11 - z00);
      const vec3 right(cell, 0.0f, z10 - z00), left(0.0f, cell, z01 - z00);
      on_plane(vec3(z00 - z10, z10 - z11, cell), v00, false);
      on_plane(vec3(z01 - z11, z00 - z01, cell), v00, true);
      on_edge(v00, v11 - v00);
      if (j == j0) on_edge(v00, right);  // else of the cell before
      if (i == i0) on_edge(v00, left);
      on_edge(v00 + right, vec3(0.0f, cell, z11 - z10)), on_edge(v00 + left, vec3(cell, 0.0f, z11 - z01));
    }
  const float distance = sqrtf(best);
  const vec3 n = wp::normalize(plane);
  normal = on_edge_yet ? way * (-sign / wp::max(distance, 1e-9f)) : n;
  const float found = on_edge_yet ? sign * distance : -dot(way, n);
  // a place that is no number has no distance: nothing of it was less than another
  return p[0] == p[0] && p[1] == p[1] && p[2] == p[2] ? found : p[0] + p[1] + p[2];
};

// The tangents of MuJoCo's contact frame of a normal (mju_makeFrame).
auto tangents = [](vec3 n, vec3& one, vec3& two) {
  const vec3 y = fabsf(n[1]) < 0.5f ? vec3(0.0f, 1.0f, 0.0f) : vec3(0.0f, 0.0f, 1.0f);
  one = wp::normalize(y - n * dot(y, n)), two = cross(n, one);
};

// Where a probe is (contacts.Probes); g: its place, the axis of its ring, radius and ring. R and `where`: axes
// and place, in the world, of what these are in.
auto probe_point = [&](const float* g, mat33 R, vec3 where) {
  const vec3 p = where + mul(R, read3(g));
  if (!(g[7] > 0.0f)) return p;
  const vec3 a = mul(R, read3(g + 3)), up = vec3(0.0f, 0.0f, 1.0f) - a * a[2];
  return p - up * (g[7] / sqrtf(wp::max(dot(up, up), 1e-12f)));
};
auto probe_above = [&](const float* ground, const float* g, mat33 R, vec3 where) {
  return above_ground(ground, probe_point(g, R, where)) - g[6];
};
