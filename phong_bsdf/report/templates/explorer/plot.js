// Drawings in SVG: the lobes in the plane of n and l, and the same arrows on the picture.
const ARM = 150, ORIGIN = [200, 196];
const LIMITS = [0.25, 0.5, 1, 1.5, 2, 4];
const SVG = "http://www.w3.org/2000/svg";

function drawn(parent, kind, attributes, text) {
  const element = document.createElementNS(SVG, kind);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (text !== undefined) element.textContent = text;
  parent.append(element);
  return element;
}

// The direction along the surface in the plane of n and l, to the right as the picture has it.
function tangent(found, right) {
  for (const v of [found.light.l, found.v, right, [0, 1, 0]]) {
    const t = minus(v, scaled(found.n, dot(v, found.n)));
    if (Math.hypot(...t) > 1e-3) return scaled(unit(t), dot(t, right) < -1e-9 ? -1 : 1);
  }
  return [1, 0, 0];
}

// Viewing angles at which a curve is drawn: everywhere, and more of them around the highlight.
function viewingAngles(towardR, p) {
  const found = [];
  for (let i = -90; i <= 90; i++) found.push(i * RADIANS);
  const width = 1 / Math.sqrt(p + 1);
  for (let i = -80; i <= 80; i++) found.push(towardR + width * (i / 10));
  return found.filter((x) => Math.abs(x) <= Math.PI / 2 + 1e-12).sort((a, b) => a - b);
}

function curves(found, towardLight) {
  const m = found.material, nl = Math.cos(towardLight);
  const lobe = (name) => {
    const own = { ...m, lobe: LOBES[name], height: m.physical ? Math.PI * m.ks * LOBES[name].normalization(m.p) : m.ks };
    return (angle) => reflected(own, nl, Math.max(Math.cos(angle), 1e-9), Math.cos(angle - towardLight)).highlight;
  };
  const diffuse = Math.max(...m.kd) * Math.max(nl, 0);
  return { diffuse, phong: lobe("phong"), blinnphong: lobe("blinnphong") };
}

function outline(angles, value, limit) {
  const points = angles.map((a) => {
    const radius = ARM * Math.min(value(a) / limit, 1.06);
    return `${(ORIGIN[0] + radius * Math.sin(a)).toFixed(2)},${(ORIGIN[1] - radius * Math.cos(a)).toFixed(2)}`;
  });
  return `M${ORIGIN} L${points.join(" L")} Z`;
}

function rings(svg, limit) {
  for (const part of [0.5, 1]) {
    const r = ARM * part, [x, y] = ORIGIN;
    drawn(svg, "path", { class: "ring", d: `M${x - r},${y} A${r},${r} 0 0 1 ${x + r},${y}` });
    for (const side of [-1, 1]) {
      drawn(svg, "text", { class: "scale", x: x + side * r, y: y + 15, "text-anchor": "middle" }, String(part * limit));
    }
  }
  drawn(svg, "path", { class: "ring", d: `M${ORIGIN[0] - ARM - 22},${ORIGIN[1]} h${2 * ARM + 44}` });
}

// A label beside the end of an arrow, where none of the labels `taken` is.
function labelled(group, name, [x, y], [ux, uy], taken) {
  while (taken.some(([a, b]) => Math.hypot(x - a, y - b) < 13)) [x, y] = [x - 4 * uy, y + 4 * ux];
  taken.push([x, y]);
  drawn(group, "text", { x, y, "text-anchor": "middle", "dominant-baseline": "central" }, name);
}

function arrow(svg, name, from, to, taken) {
  const [dx, dy] = [to[0] - from[0], to[1] - from[1]], length = Math.hypot(dx, dy);
  const group = drawn(svg, "g", { class: `arrow vector-${name}` });
  if (length > 4) {
    const [ux, uy] = [dx / length, dy / length], back = [to[0] - 9 * ux, to[1] - 9 * uy];
    const shaft = `M${from} L${back}`;
    drawn(group, "path", { class: "halo", d: `M${from} L${to}` });
    drawn(group, "path", { class: "shaft", d: shaft });
    drawn(group, "path", {
      class: "head", d: `M${to} L${back[0] - 4.2 * uy},${back[1] + 4.2 * ux} L${back[0] + 4.2 * uy},${back[1] - 4.2 * ux} Z`,
    });
    labelled(group, name, [to[0] + 12 * ux, to[1] + 12 * uy], [ux, uy], taken);
  } else {
    drawn(group, "circle", { class: "head", cx: from[0], cy: from[1], r: 3.5 });
    labelled(group, name, [from[0] + 12, from[1] - 12], [1, 0], taken);
  }
}

// Vectors of the drawing, in the order in which they are drawn; a light behind the surface has no r and no h.
const vectors = ({ n, v, light: { l, r, h, nl } }) =>
  [["n", n], ["r", r], ["l", l], ["h", h], ["v", v]].filter(([name]) => nl > 0 || !"rh".includes(name));

function drawPlot(svg, found, world, s) {
  svg.replaceChildren();
  const t = tangent(found, world.camera.right), { l, nl } = found.light;
  const towardLight = Math.atan2(dot(l, t), nl), seenAngles = viewingAngles(-towardLight, found.material.p);
  const { diffuse, ...lobe } = curves(found, towardLight), other = s.lobe === "phong" ? "blinnphong" : "phong";
  const peak = diffuse + Math.max(lobe[s.lobe](-towardLight), lobe[other](-towardLight), 0);
  const limit = LIMITS.find((x) => x >= peak) ?? LIMITS[LIMITS.length - 1];
  rings(svg, limit);
  if (nl > 0) {
    const total = (name) => (a) => diffuse + lobe[name](a);
    drawn(svg, "path", { class: "lobe", "data-lobe": s.lobe, d: outline(seenAngles, total(s.lobe), limit) });
    drawn(svg, "path", { class: "other", "data-lobe": other, d: outline(seenAngles, total(other), limit) });
    drawn(svg, "path", { class: "diffuse", d: outline(seenAngles, () => diffuse, limit) });
  }
  const flat = (v) => [ORIGIN[0] + ARM * dot(v, t), ORIGIN[1] - ARM * dot(v, found.n)];
  const taken = [];
  for (const [name, v] of vectors(found)) arrow(svg, name, ORIGIN, flat(v), taken);
  if (found.nv > 0 && nl > 0) {
    const value = Math.max(...found.material.kd) * found.light.diffuse + found.light.highlight;
    const v = flat(found.v), length = Math.max(Math.hypot(v[0] - ORIGIN[0], v[1] - ORIGIN[1]), 1e-6);
    const radius = ARM * Math.min(value / limit, 1.06);
    const [cx, cy] = ORIGIN.map((start, i) => start + ((v[i] - start) / length) * radius);
    drawn(svg, "circle", { class: "value", r: 5, cx, cy });
  }
  const leaning = Math.asin(clamp(Math.abs(dot(found.v, cross(found.n, t))), 0, 1)) / RADIANS;
  return { peak, limit, leaning };
}

// The point, its arrows, and the circle on the ball that the plot cuts out.
function drawOverlay(svg, found, world, arrows) {
  svg.replaceChildren();
  const place = (p) => world.camera.place(p), at = place(found.p);
  if (found.surface === "ball" && arrows) {
    const t = tangent(found, world.camera.right), path = [];
    for (let i = 0; i <= 120; i++) {
      const a = i * 3 * RADIANS, q = add(scaled(found.n, Math.cos(a)), scaled(t, Math.sin(a)));
      const front = dot(q, minus(world.camera.eye, q)) > 0, [x, y] = place(q);
      path.push(`${front && path.length && path[path.length - 1] !== "" ? "L" : "M"}${x.toFixed(1)},${y.toFixed(1)}`);
      if (!front) path[path.length - 1] = "";
    }
    drawn(svg, "path", { class: "circle", d: path.join(" ") });
  }
  if (arrows && found.visible) {
    const taken = [];
    // The one toward the viewer is seen from its end.
    const end = (name, v) => place(add(found.p, scaled(v, name === "v" ? 1.4 : 0.75)));
    for (const [name, v] of vectors(found)) arrow(svg, name, at, end(name, v), taken);
  }
  drawn(svg, "circle", { class: found.visible ? "point" : "point hidden", cx: at[0], cy: at[1], r: 6 });
}
