// Settings, vectors and the reflection model.
const RADIANS = Math.PI / 180;
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
const scaled = (a, k) => [a[0] * k, a[1] * k, a[2] * k];
const minus = (a, b) => add(a, scaled(b, -1));
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => scaled(a, 1 / Math.hypot(...a));
const mirrored = (v, n) => minus(scaled(n, 2 * dot(n, v)), v);
const clamp = (x, low, high) => Math.min(Math.max(x, low), high);

// Azimuth 0 is toward the first camera, 90 to its right; elevation 90 is straight up.
const placed = (azimuth, elevation, distance) => [
  distance * Math.cos(elevation * RADIANS) * Math.sin(azimuth * RADIANS),
  distance * Math.sin(elevation * RADIANS),
  distance * Math.cos(elevation * RADIANS) * Math.cos(azimuth * RADIANS),
];
const angles = (v) => [Math.atan2(v[0], v[2]) / RADIANS, Math.asin(clamp(v[1] / Math.hypot(...v), -1, 1)) / RADIANS];

// Colours are linear: byte / 255, which is also what the linear display shows.
const channels = (hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16) / 255);

// The stage: a ball of radius 1 at the origin on a board of 8 x 8 squares, under an even sky.
const FLOOR_HALF = 4, SQUARES = [0.5, 0.22], SKY = [0.36, 0.45, 0.57];
const EYE = 7, FIELD_OF_VIEW = 26, SIZE = 480, MAX_DEPTH = 10;

// With falloff, a light at this distance is as bright as without.
const REFERENCE_DISTANCE = 5;

const DEFAULTS = {
  lobe: "blinnphong", terms: "lecture", kd: 0.8, colour: "#cc3319", ks: 0.6, p: 60, km: 0,
  azimuth: 0, elevation: 15, count: 1, falloff: false, floor: "matte", display: "linear",
  lights: [
    { azimuth: -45, elevation: 40, distance: 5, intensity: 1, colour: "#ffffff" },
    { azimuth: 55, elevation: 30, distance: 5, intensity: 0.5, colour: "#ffffff" },
    { azimuth: 180, elevation: 35, distance: 5, intensity: 0.5, colour: "#ffffff" },
    { azimuth: 0, elevation: 85, distance: 5, intensity: 0.5, colour: "#ffffff" },
  ],
  point: { on: "ball", at: [-9, 33] },
};

// The package's formulas (lobes.py) in float64: there a cosine is rounded by 1e-16, which at p = 1e6 changes its power
// by 1e-10, so that Math.pow does. In float32 it would be 10 %, hence the package's other form.
const LOBES = {
  phong: {
    name: "Phong",
    cosine: (nl, nv, lv) => 2 * nl * nv - lv,
    normalization: (p) => (p + 2) / (2 * Math.PI),
  },
  blinnphong: {
    name: "Blinn-Phong",
    cosine: (nl, nv, lv) => (nl + nv) / Math.sqrt(Math.max(2 + 2 * lv, 1e-30)),
    normalization: (p) => ((p + 2) * (p + 4)) / (8 * Math.PI * (2 ** (-p / 2) + p)),
  },
};

// The lobe's value; 0^0 = 1, as in JavaScript.
const power = (cosine, p) => Math.max(cosine, 0) ** p;

// What one material is: colours and scales after the energy rule of the physical terms.
function material(s, diffuse, glossy) {
  const ks = glossy ? s.ks : 0, physical = s.terms === "physical";
  const largest = Math.max(...diffuse) + ks;
  // A matte floor is `diffuse`, which has no such rule. The rounding is that of energy.py.
  const scale = physical && glossy && largest > 1 + 1e-6 ? 0.99 / largest : 1;
  const c = physical ? LOBES[s.lobe].normalization(s.p) : null;
  return {
    kd: scaled(diffuse, scale), ks: ks * scale, km: glossy ? s.km : 0, p: s.p, lobe: LOBES[s.lobe], scale, c, physical,
    // What the lobe is multiplied with; in physical terms n.l comes on top.
    height: physical ? Math.PI * ks * scale * c : ks,
  };
}

// All materials of the settings, by what is hit. The energy rule of a texture goes by its brightest square.
function materials(s) {
  const glossy = s.floor === "glossy";
  const brightest = material(s, [SQUARES[0], SQUARES[0], SQUARES[0]], glossy);
  const square = (value) => ({ ...brightest, kd: scaled([value, value, value], brightest.scale) });
  return { ball: material(s, scaled(channels(s.colour), s.kd), true), even: square(SQUARES[0]), odd: square(SQUARES[1]) };
}

// pi f cos of a material: the factor of kd, and the highlight.
function reflected(m, nl, nv, lv) {
  if (nl <= 0 || nv <= 0) return { diffuse: 0, highlight: 0, cosine: m.lobe.cosine(nl, nv, lv) };
  const cosine = m.lobe.cosine(nl, nv, lv);
  const highlight = m.height === 0 ? 0 : m.height * power(cosine, m.p) * (m.physical ? nl : 1);
  return { diffuse: nl, highlight, cosine };
}

// What arrives of a light at distance d, per intensity.
const arriving = (s, d) => (s.falloff ? (REFERENCE_DISTANCE / d) ** 2 : 1);
