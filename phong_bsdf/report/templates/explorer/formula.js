// The formula at the point with its numbers.
const digits = (x) => {
  if (!Number.isFinite(x)) return String(x);
  if (x !== 0 && (Math.abs(x) < 1e-3 || Math.abs(x) >= 1e5)) {
    const [mantissa, exponent] = x.toExponential(2).split("e");
    return `${mantissa}·10<sup>${Number(exponent)}</sup>`.replace("-", "−");
  }
  return String(Number(x.toPrecision(3))).replace("-", "−");
};

// A cosine near 1 with enough digits to tell it from 1.
const cosineText = (c) => {
  const rest = 1 - c;
  if (rest <= 0 || rest > 0.01) return c.toFixed(3).replace("-", "−");
  return c.toFixed(Math.min(Math.ceil(-Math.log10(rest)) + 2, 15));
};

// Three channels take as many digits as they need not to jump about; no line ends within them.
function colourText(c) {
  if (c[0] === c[1] && c[1] === c[2]) return digits(c[0]);
  const largest = Math.max(...c);
  return `(${c.map((x) => (largest >= 0.01 && largest < 100 ? x.toFixed(largest < 10 ? 3 : 2) : digits(x))).join(",\u00a0")})`;
}

const swatch = (c, s) => {
  const bytes = c.map((x) => Math.round(255 * (s.display === "srgb" ? encoded(clamp(x, 0, 1)) : clamp(x, 0, 1))));
  return `<span class="swatch" style="background: rgb(${bytes.join(",")})"></span>`;
};
const sub = (name, index) => `<i>${name}</i><sub>${index}</sub>`;

function angleText(found) {
  const degrees = (c) => `${(Math.acos(clamp(c, -1, 1)) / RADIANS).toFixed(1)}°`;
  const { nl, rv, nh } = found.light;
  return Object.entries({ "n, l": nl, "n, v": found.nv, "r, v": rv, "n, h": nh })
    .map(([pair, cosine]) => `<span>∠(${pair}) <b>${degrees(cosine)}</b></span>`).join("");
}

// Why a light adds nothing at the point; empty where it does.
function darkness({ nv, light }) {
  if (light.shadow) return "in the shadow";
  if (light.nl <= 0) return "the light is behind the surface";
  return nv <= 0 ? "seen from behind" : "";
}

// Rows of [name, formula, its numbers or why there are none, result].
function formulaRows(found, s, chosen) {
  const { material: m, light } = found, k = m.physical ? "ρ" : "k", phong = s.lobe === "phong";
  const many = s.count > 1 ? ` <small>light ${chosen + 1}</small>` : "", dark = darkness(found);
  const cosine = cosineText(Math.max(phong ? light.rv : light.nh, 0)), nl = cosineText(light.nl);
  const factor = `${phong ? "(r·v)" : "(n·h)"}<sup><i>p</i></sup>`, raised = `${cosine}<sup>${digits(m.p)}</sup>`;
  const near = s.falloff ? "(5/<i>d</i>)²" : "";
  const arrives = colourText(light.colour) + (s.falloff ? ` · ${digits((REFERENCE_DISTANCE / light.distance) ** 2)}` : "");
  const part = (scale) => scaled(light.colour, light.incoming * scale);
  const diffuse = part(light.diffuse).map((x, i) => x * m.kd[i]), highlight = part(light.highlight);
  const own = (name) => `${sub("L", name)}${many}`;
  const specular = m.physical
    ? [`π ${sub("ρ", "s")} <i>c</i>(<i>p</i>) <i>I</i> ${near} ${factor} (n·l)`,
      `π · ${digits(m.ks)} · ${digits(m.c)} · ${arrives} · ${raised} · ${nl}`]
    : [`${sub("k", "s")} <i>I</i> ${near} ${factor}`, `${digits(m.ks)} · ${arrives} · ${raised}`];
  const mirror = m.km > 0
    ? `= ${digits(m.km)} · ${colourText(found.mirror)} + ${digits(1 - m.km)} · ${colourText(found.local)}`
    : `${sub("k", "m")} = 0: no mirror`;
  const sums = (s.count > 1 ? found.lights.map((one) => one.sum) : [diffuse, highlight]).map(colourText).join(" + ");
  return [
    [own("d"), `${sub(k, "d")} <i>I</i> ${near} (n·l)`, dark || `= ${colourText(m.kd)} · ${arrives} · ${nl}`, diffuse],
    [own("s"), specular[0], dark || `= ${specular[1]}`, highlight],
    ["Σ", `${sub("L", "d")} + ${sub("L", "s")}${s.count > 1 ? " of all lights" : ""}`, `= ${sums}`, found.local],
    ["<i>L</i>", `${sub("k", "m")} ${sub("L", "r")} + (1 − ${sub("k", "m")}) Σ`, mirror, found.result],
  ];
}

function writeFormula(body, found, s, chosen) {
  body.innerHTML = formulaRows(found, s, chosen).map(([name, formula, numbers, result]) =>
    `<div><dt>${name} = ${formula}</dt><dd class="numbers">${numbers}</dd>
      <dd class="result">= ${colourText(result)} ${swatch(result, s)}</dd></div>`).join("");
}

// For those who hear the page.
function spoken(found, s) {
  const plain = (x) => String(Number(x.toPrecision(2)));
  const where = found.surface === "ball" ? "Ball" : "Board";
  const { nl, rv, nh } = found.light, dark = darkness(found);
  const cosine = s.lobe === "phong" ? `r dot v ${plain(rv)}` : `n dot h ${plain(nh)}`;
  return `${where}: n dot l ${plain(nl)}, ${cosine}${dark && `, ${dark}`}, L ${found.result.map(plain).join(", ")}`;
}
