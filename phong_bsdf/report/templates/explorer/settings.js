// The address keeps what differs from the defaults: #lobe=phong&p=100&light1=-50,45,5,1,ffffff
const CHOICES = {
  lobe: ["phong", "blinnphong"], terms: ["lecture", "physical"],
  floor: ["none", "matte", "glossy"], display: ["linear", "srgb"],
};
const RANGES = {
  kd: [0, 1], ks: [0, 1], p: [0, 1e6], km: [0, 1], azimuth: [-180, 180], elevation: [0, 85], count: [1, 4],
};
const LIGHT_RANGES = { azimuth: [-180, 180], elevation: [-90, 90], distance: [2, 10], intensity: [0, 4] };
const COLOUR = /^#[0-9a-f]{6}$/i;

const copied = (value) => JSON.parse(JSON.stringify(value));
const brief = (x) => String(Number(x.toFixed(3)));

function toHash(s) {
  const parts = [];
  for (const key of [...Object.keys(CHOICES), ...Object.keys(RANGES)]) {
    if (s[key] !== DEFAULTS[key]) parts.push(`${key}=${s[key]}`);
  }
  if (s.colour !== DEFAULTS.colour) parts.push(`colour=${s.colour.slice(1)}`);
  if (s.falloff) parts.push("falloff=1");
  s.lights.forEach((light, i) => {
    const text = (l) => [...Object.keys(LIGHT_RANGES).map((key) => brief(l[key])), l.colour.slice(1)].join(",");
    if (text(light) !== text(DEFAULTS.lights[i])) parts.push(`light${i + 1}=${text(light)}`);
  });
  const point = (p) => [p.on, ...p.at.map(brief)].join(",");
  if (point(s.point) !== point(DEFAULTS.point)) parts.push(`point=${point(s.point)}`);
  return parts.join("&");
}

// What cannot be read is left at its default.
function fromHash(text) {
  const s = copied(DEFAULTS), given = new URLSearchParams(text.replace(/^#/, ""));
  const number = (text, [low, high], other) => {
    const x = text === null || text === "" ? NaN : Number(text);
    return Number.isFinite(x) ? clamp(x, low, high) : other;
  };
  for (const [key, choices] of Object.entries(CHOICES)) if (choices.includes(given.get(key))) s[key] = given.get(key);
  for (const [key, range] of Object.entries(RANGES)) s[key] = number(given.get(key), range, s[key]);
  s.count = Math.round(s.count);
  const colour = (text, other) => (COLOUR.test(`#${text}`) ? `#${text}`.toLowerCase() : other);
  s.colour = colour(given.get("colour"), s.colour);
  s.falloff = given.get("falloff") === "1";
  s.lights.forEach((light, i) => {
    const values = (given.get(`light${i + 1}`) ?? "").split(",");
    Object.entries(LIGHT_RANGES).forEach(([key, range], j) => { light[key] = number(values[j] ?? null, range, light[key]); });
    light.colour = colour(values[4], light.colour);
  });
  const [on, ...at] = (given.get("point") ?? "").split(",");
  if (["ball", "floor"].includes(on) && at.length === 2 && at.every((x) => x !== "" && Number.isFinite(Number(x)))) {
    s.point = { on, at: at.map(Number) };
  }
  return s;
}

const light = (azimuth, elevation, intensity = 1, colour = "#ffffff", distance = 5) =>
  ({ azimuth, elevation, distance, intensity, colour });

const PRESETS = [
  { name: "Lambert", set: { ks: 0 },
    words: "Only the diffuse part: L = k_d I (n·l). It depends on the light's angle alone: from every side the same, a half circle in the plot." },
  { name: "Phong", set: { lobe: "phong" },
    words: "The highlight is brightest where the viewer looks along r, the light's mirror direction, and falls off with the angle between r and v." },
  { name: "Exponent", set: { kd: 0.3, ks: 0.8, p: 100, point: { on: "ball", at: [-20.495, 29.798] } },
    words: "Move p through 1, 10, 100, 1000: the highlight shrinks, its height stays k_s. The lecture's model does not conserve energy; the physical terms do." },
  { name: "Four times p", set: { lobe: "blinnphong", p: 120, ks: 0.8 },
    words: "With the same p, Blinn-Phong's lobe is twice as wide as Phong's, because h turns half as fast as r: with p = 120 it looks like Phong with p = 30." },
  { name: "Grazing light", set: {
      lobe: "blinnphong", floor: "glossy", p: 150, ks: 0.8, elevation: 7, count: 2,
      lights: [light(165, 3, 1, "#ffffff", 10), light(-30, 35, 0.3)], point: { on: "floor", at: [1.3, -0.9] } },
    words: "A low sun over a wet street. Switch between Blinn-Phong and Phong: on the board Blinn-Phong's highlight is long and narrow, Phong's is round." },
  { name: "Light is additive", set: {
      count: 3, colour: "#ffffff", kd: 0.8, ks: 0.5, elevation: 25,
      lights: [light(-60, 40, 0.8, "#ff0000"), light(0, 45, 0.8, "#00ff00"), light(60, 40, 0.8, "#0000ff")],
      point: { on: "ball", at: [0, 40] } },
    words: "A red, a green and a blue light on a white ball: L is the sum over the lights. Each shadow lacks one of them." },
  { name: "Falloff", set: {
      falloff: true, floor: "matte", elevation: 35, lights: [light(-70, 25, 0.3, "#ffffff", 2.6)], point: { on: "floor", at: [-1.2, 0.6] } },
    words: "With 1/d² a near light is bright and the far side of the board dark. The lecture leaves it out: switch it off and compare." },
  { name: "Mirror", set: { km: 0.5, kd: 0.6, floor: "matte", elevation: 18, point: { on: "ball", at: [10, -5] } },
    words: "L = k_m L_r + (1 − k_m) Σ: half of the ball's light is what it mirrors, the other half its own. At k_m = 1 nothing of its own is left." },
  { name: "Energy", set: { terms: "physical", kd: 0.5, ks: 0.2, p: 30 },
    words: "Reflectances instead of heights: the lobe is multiplied with c(p) and n·l. Move p: the narrower the highlight, the brighter, with the same light in all." },
];

function preset(chosen) {
  const s = { ...copied(DEFAULTS), ...copied(chosen.set) };
  s.lights = [...s.lights, ...copied(DEFAULTS.lights).slice(s.lights.length)];
  return s;
}
