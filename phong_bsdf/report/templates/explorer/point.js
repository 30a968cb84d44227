// The point that the formula is about, and all that the formula needs there.
function surfacePoint(point) {
  if (point.on === "ball") {
    const n = placed(point.at[0], point.at[1], 1);
    return { surface: "ball", p: n, n };
  }
  const [x, z] = point.at;
  return { surface: (Math.floor(x) + Math.floor(-z)) % 2 === 0 ? "even" : "odd", p: [x, -1, z], n: [0, 1, 0] };
}

const pointOf = (hit) =>
  hit.surface === "ball" ? { on: "ball", at: angles(hit.n) } : { on: "floor", at: [hit.p[0], hit.p[2]] };

// One record for the plot, the arrows and the formula; `chosen` is the light whose arrows are drawn.
function examine(world, s, point, chosen) {
  const { surface, p, n } = surfacePoint(point), m = world.materials[surface], { eye } = world.camera;
  const v = unit(minus(eye, p)), nv = dot(n, v);
  const lights = world.lights.map((light) => {
    const way = minus(light.at, p), distance = Math.hypot(...way), l = unit(way), nl = dot(n, l);
    const found = reflected(m, nl, nv, dot(l, v)), shadow = nl > 0 && world.shadowed(surface, p, light.at);
    const incoming = shadow ? 0 : arriving(s, distance);
    const h = unit(add(l, v));
    return {
      l, nl, h, distance, shadow, r: mirrored(l, n), rv: dot(mirrored(l, n), v), nh: dot(n, h), ...found,
      colour: light.colour, incoming,
      sum: [0, 1, 2].map((i) => incoming * light.colour[i] * (m.kd[i] * found.diffuse + found.highlight)),
    };
  });
  const local = lights.reduce((total, light) => add(total, light.sum), [0, 0, 0]);
  let mirror = null;
  if (m.km > 0) {
    mirror = new Float64Array(3);
    const d = mirrored(v, n), start = add(p, scaled(n, 1e-9));
    world.trace(mirror, ...start, ...d);
    mirror = [...mirror];
  }
  const result = [0, 1, 2].map((i) => (mirror ? m.km * mirror[i] : 0) + (1 - m.km) * local[i]);
  const seen = world.hit(eye, scaled(v, -1));
  const inside = world.camera.place(p).every((x) => x >= 0 && x <= SIZE);
  const visible = inside && nv > 0 && seen !== null && Math.hypot(...minus(seen.p, p)) < 1e-6;
  return { surface, p, n, v, nv, material: m, lights, light: lights[chosen], local, mirror, result, visible };
}

// Where on the ball the chosen light's highlight is: where n is the bisector of l and v.
function highlightPoint(world, chosen) {
  let n = unit(add(unit(world.lights[chosen].at), unit(world.camera.eye)));
  for (let i = 0; i < 50; i++) n = unit(add(unit(minus(world.lights[chosen].at, n)), unit(minus(world.camera.eye, n))));
  return { on: "ball", at: angles(n) };
}

// The nearest point of the ball where n, l and v lie in one plane: that through eye, light and the ball's centre.
function planePoint(world, chosen, point) {
  const normal = cross(world.lights[chosen].at, world.camera.eye);
  if (Math.hypot(...normal) < 1e-6) return point;
  const m = unit(normal), { n } = surfacePoint(point), across = minus(n, scaled(m, dot(n, m)));
  return Math.hypot(...across) < 1e-6 ? highlightPoint(world, chosen) : { on: "ball", at: angles(across) };
}
