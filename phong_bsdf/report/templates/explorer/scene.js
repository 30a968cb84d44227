// The picture: rays from the eye, shadows, mirrors, as `whitted` does it.
const NOTHING = 0, BALL = 1, EVEN = 2, ODD = 3;
const SURFACES = ["nothing", "ball", "even", "odd"];

function camera(s) {
  const eye = placed(s.azimuth, s.elevation, EYE);
  const forward = unit(scaled(eye, -1)), right = unit(cross(forward, [0, 1, 0])), up = cross(right, forward);
  const half = Math.tan((FIELD_OF_VIEW / 2) * RADIANS);
  return {
    eye, right, up,
    // The direction through a place of the picture, in pixels; into an array, since arrays take time to make.
    aim: (out, x, y) => {
      const u = half * ((2 * x) / SIZE - 1), v = half * (1 - (2 * y) / SIZE), length = Math.sqrt(1 + u * u + v * v);
      for (let i = 0; i < 3; i++) out[i] = (forward[i] + u * right[i] + v * up[i]) / length;
      return out;
    },
    place: (p) => {
      const d = minus(p, eye), z = dot(d, forward) * half;
      return [(SIZE / 2) * (1 + dot(d, right) / z), (SIZE / 2) * (1 - dot(d, up) / z)];
    },
  };
}

// Everything about the settings that a ray needs. `trace` fills an array with the radiance, `hit` tells what is met.
function compile(s) {
  const table = materials(s), surfaces = [null, table.ball, table.even, table.odd];
  const floor = s.floor !== "none";
  const lights = s.lights.slice(0, s.count).map((light) => ({
    at: placed(light.azimuth, light.elevation, light.distance), colour: scaled(channels(light.colour), light.intensity),
  }));
  const [px, py, pz, red, green, blue] = [0, 1, 2].map((i) => Float64Array.from(lights, (light) => light.at[i]))
    .concat([0, 1, 2].map((i) => Float64Array.from(lights, (light) => light.colour[i])));
  const phong = s.lobe === "phong", physical = s.terms === "physical", falloff = s.falloff;
  const mostHits = MAX_DEPTH - 1, mostRays = mostHits + (falloff ? 1 : 0);

  // What a ray meets, and where: in an array, because a variable of several functions is made anew with each value.
  let what = NOTHING;
  const spot = new Float64Array(3);

  function intersect(ox, oy, oz, dx, dy, dz) {
    what = NOTHING;
    let t = Infinity;
    const b = ox * dx + oy * dy + oz * dz, root = b * b - (ox * ox + oy * oy + oz * oz - 1);
    if (root > 0 && -b - Math.sqrt(root) > 1e-9) {
      t = -b - Math.sqrt(root);
      what = BALL;
    }
    if (floor && dy < 0) {
      const u = (-1 - oy) / dy, fx = ox + u * dx, fz = oz + u * dz;
      if (u > 1e-9 && u < t && Math.abs(fx) <= FLOOR_HALF && Math.abs(fz) <= FLOOR_HALF) {
        t = u;
        what = (Math.floor(fx) + Math.floor(-fz)) % 2 === 0 ? EVEN : ODD;
      }
    }
    spot[0] = ox + t * dx;
    spot[1] = oy + t * dy;
    spot[2] = oz + t * dz;
  }

  // Whether something lies strictly between a point of `from` and the light at l.
  function blocked(from, x, y, z, lx, ly, lz) {
    const dx = lx - x, dy = ly - y, dz = lz - z;
    if (from === BALL) {
      if (!floor || dy >= 0) return false;
      const u = (-1 - y) / dy;
      return u > 0 && u < 1 && Math.abs(x + u * dx) <= FLOOR_HALF && Math.abs(z + u * dz) <= FLOOR_HALF;
    }
    const a = dx * dx + dy * dy + dz * dz, b = x * dx + y * dy + z * dz, root = b * b - a * (x * x + y * y + z * z - 1);
    if (root <= 0) return false;
    const u = (-b - Math.sqrt(root)) / a;
    return u > 1e-9 && u < 1;
  }

  // Adds the light that `weight` of the surface at the point sends against the direction d: `reflected` of model.js,
  // written out, since this runs for each sample and light.
  function shade(out, weight, dx, dy, dz) {
    const m = surfaces[what], ball = what === BALL, x = spot[0], y = spot[1], z = spot[2];
    const nx = ball ? x : 0, ny = ball ? y : 1, nz = ball ? z : 0;
    const nv = -(nx * dx + ny * dy + nz * dz);
    if (nv <= 0) return;
    for (let i = 0; i < px.length; i++) {
      let lx = px[i] - x, ly = py[i] - y, lz = pz[i] - z;
      const square = lx * lx + ly * ly + lz * lz, length = Math.sqrt(square);
      lx /= length;
      ly /= length;
      lz /= length;
      const nl = nx * lx + ny * ly + nz * lz;
      if (nl <= 0 || blocked(what, x, y, z, px[i], py[i], pz[i])) continue;
      let highlight = 0;
      if (m.height !== 0) {
        const lv = -(lx * dx + ly * dy + lz * dz);
        const cosine = phong ? 2 * nl * nv - lv : (nl + nv) / Math.sqrt(Math.max(2 + 2 * lv, 1e-30));
        highlight = m.height * (cosine > 0 ? cosine ** m.p : m.p === 0 ? 1 : 0) * (physical ? nl : 1);
      }
      const k = weight * (falloff ? (REFERENCE_DISTANCE * REFERENCE_DISTANCE) / square : 1);
      out[0] += k * red[i] * (m.kd[0] * nl + highlight);
      out[1] += k * green[i] * (m.kd[1] * nl + highlight);
      out[2] += k * blue[i] * (m.kd[2] * nl + highlight);
    }
  }

  function trace(out, ox, oy, oz, dx, dy, dz) {
    out[0] = out[1] = out[2] = 0;
    let weight = 1;
    for (let depth = 0; depth < mostRays; depth++) {
      intersect(ox, oy, oz, dx, dy, dz);
      if (what === NOTHING) {
        for (let i = 0; i < 3; i++) out[i] += weight * SKY[i];
        return;
      }
      if (depth === mostHits) return;
      const km = surfaces[what].km;
      // Where the budget ends, the lecture's convention shows the surface as if km = 0.
      shade(out, weight * (depth === mostHits - 1 && !falloff ? 1 : 1 - km), dx, dy, dz);
      weight *= km;
      if (weight === 0) return;
      const ball = what === BALL, nx = ball ? spot[0] : 0, ny = ball ? spot[1] : 1, nz = ball ? spot[2] : 0;
      const twice = 2 * (nx * dx + ny * dy + nz * dz);
      dx -= twice * nx;
      dy -= twice * ny;
      dz -= twice * nz;
      ox = spot[0];
      oy = spot[1];
      oz = spot[2];
    }
  }

  function hit(o, d) {
    intersect(...o, ...d);
    const p = [...spot];
    return what === NOTHING ? null : { surface: SURFACES[what], p, n: what === BALL ? p : [0, 1, 0] };
  }

  const shadowed = (surface, p, light) => blocked(SURFACES.indexOf(surface), ...p, ...light);
  return { camera: camera(s), lights, materials: table, trace, hit, shadowed };
}

const encoded = (x) => (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055);

// Rows of the picture: `grid` x `grid` samples in each pixel, or one for each block of -`grid` pixels.
function renderRows(world, s, image, first, last, grid) {
  const { eye, aim } = world.camera, block = Math.max(-grid, 1), n = Math.max(grid, 1);
  const d = new Float64Array(3), out = new Float64Array(3), sum = new Float64Array(3), srgb = s.display === "srgb";
  for (let row = first; row < last; row += block) {
    for (let column = 0; column < SIZE; column += block) {
      sum.fill(0);
      for (let k = 0; k < n * n; k++) {
        aim(d, column + (block * ((k % n) + 0.5)) / n, row + (block * (Math.floor(k / n) + 0.5)) / n);
        world.trace(out, eye[0], eye[1], eye[2], d[0], d[1], d[2]);
        for (let i = 0; i < 3; i++) sum[i] += out[i] / (n * n);
      }
      for (let i = 0; i < 3; i++) sum[i] = clamp(sum[i], 0, 1);
      // A Uint8ClampedArray rounds.
      for (let v = row; v < Math.min(row + block, SIZE); v++) {
        for (let u = column; u < Math.min(column + block, SIZE); u++) {
          const at = 4 * (v * SIZE + u);
          for (let i = 0; i < 3; i++) image.data[at + i] = 255 * (srgb ? encoded(sum[i]) : sum[i]);
          image.data[at + 3] = 255;
        }
      }
    }
  }
}
