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

// Three channels take as many digits as they need not to jump about.
function colourText(c) {
  if (c[0] === c[1] && c[1] === c[2]) return digits(c[0]);
  const largest = Math.max(...c);
  return `(${c.map((x) => (largest >= 0.01 && largest < 100 ? x.toFixed(3) : digits(x))).join(", ")})`;
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

// Rows of [name, formula, numbers, result].
function formulaRows(found, s, chosen) {
  const { material: m, light } = found, physical = m.physical, k = physical ? "ρ" : "k", phong = s.lobe === "phong";
  const many = s.count > 1 ? ` <small>light ${chosen + 1}</small>` : "";
  const dots = phong ? "(r·v)" : "(n·h)", cosine = phong ? light.rv : light.nh;
  const intensity = colourText(light.colour), near = s.falloff ? `(5/<i>d</i>)²` : "";
  const arrives = s.falloff ? ` · ${digits((REFERENCE_DISTANCE / light.distance) ** 2)}` : "";
  const lit = light.nl > 0 && found.nv > 0;
  const zero = (text) => (light.shadow ? "in the shadow" : light.nl <= 0 ? "the light is behind the surface" : found.nv <= 0 ? "seen from behind" : text);
  const part = (scale) => scaled(light.colour, light.incoming * scale);
  const diffuse = [0, 1, 2].map((i) => part(light.diffuse)[i] * m.kd[i]), highlight = part(light.highlight);
  const cos = cosineText(Math.max(lit ? light.cosine : cosine, 0)), exponent = `<sup>${digits(m.p)}</sup>`;
  return [
    [`${sub("L", "d")}${many}`, `${sub(k, "d")} <i>I</i> ${near} (n·l)`,
      zero(`${colourText(m.kd)} · ${intensity}${arrives} · ${cosineText(light.nl)}`), diffuse],
    [`${sub("L", "s")}${many}`,
      physical ? `π ${sub(k, "s")} <i>c</i>(<i>p</i>) <i>I</i> ${near} ${dots}<sup><i>p</i></sup> (n·l)` : `${sub(k, "s")} <i>I</i> ${near} ${dots}<sup><i>p</i></sup>`,
      zero(physical ? `π · ${digits(m.ks)} · ${digits(m.c)} · ${intensity}${arrives} · ${cos}${exponent} · ${cosineText(light.nl)}`
        : `${digits(m.ks)} · ${intensity}${arrives} · ${cos}${exponent}`), highlight],
    ["Σ", `all ${sub("L", "d")} + ${sub("L", "s")}`, found.lights.map((one) => colourText(one.sum)).join(" + "), found.local],
    [`<i>L</i>`, `${sub("k", "m")} ${sub("L", "r")} + (1 − ${sub("k", "m")}) Σ`,
      m.km > 0 ? `${digits(m.km)} · ${colourText(found.mirror)} + ${digits(1 - m.km)} · ${colourText(found.local)}`
        : "<i>k</i><sub>m</sub> = 0: no mirror", found.result],
  ];
}

function writeFormula(body, found, s, chosen) {
  body.innerHTML = formulaRows(found, s, chosen).map(([name, formula, numbers, result]) =>
    `<div><dt>${name} = ${formula}</dt><dd class="numbers" tabindex="-1">= ${numbers}</dd><dd class="result">= ${colourText(result)} ${swatch(result, s)}</dd></div>`).join("");
}

// For those who hear the page.
function spoken(found, s) {
  const plain = (x) => String(Number(x.toPrecision(2)));
  const where = found.surface === "ball" ? "Ball" : "Board";
  const { nl, rv, nh, shadow } = found.light;
  const cosine = s.lobe === "phong" ? `r dot v ${plain(rv)}` : `n dot h ${plain(nh)}`;
  return `${where}: n dot l ${plain(nl)}, ${cosine}${shadow ? ", in the shadow" : ""}, L ${found.result.map(plain).join(", ")}`;
}
