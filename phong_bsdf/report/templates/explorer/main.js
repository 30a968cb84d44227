// The page: one state, drawn whenever it changes.
const canvas = find("#picture"), context = canvas.getContext("2d"), image = context.createImageData(SIZE, SIZE);
const state = { s: fromHash(location.hash), light: 0, move: "point", probe: null };
let world = compile(state.s);

// A moving picture may take this long; at rest it is refined in steps of as long.
const FRAME = 13;
const REST = 160;
let frame = 0, rest = 0, block = 2;

function drawPicture() {
  const start = performance.now();
  renderRows(world, state.s, image, 0, SIZE, -block);
  context.putImageData(image, 0, 0);
  const took = performance.now() - start;
  if (took > FRAME) block = Math.min(block + 1, 5);
  else if (block > 1 && took * (block / (block - 1)) ** 2 < FRAME) block -= 1;
  rest = setTimeout(() => refine(0), REST);
}

function refine(row) {
  const start = performance.now();
  while (row < SIZE && performance.now() - start < FRAME) renderRows(world, state.s, image, row, row += 4, 2);
  if (row < SIZE) rest = setTimeout(() => refine(row), 0);
  else {
    context.putImageData(image, 0, 0);
    canvas.dataset.ready = "";
    history.replaceState(null, "", `#${toHash(state.s)}`);
  }
}

function drawPoint() {
  const { s } = state, found = examine(world, s, state.probe ?? s.point, state.light);
  const { peak, limit, leaning } = drawPlot(find("#plot"), found, world, s);
  drawOverlay(find("#arrows"), found, world, find("#show-arrows").checked);
  writeFormula(find("#formula"), found, s, state.light);
  find("#plot-angles").innerHTML = angleText(found);
  find("#plot-note").innerHTML = [
    leaning > 1 ? `v leans ${leaning.toFixed(0)}° out of this plane.` : "n, l and v lie in this plane.",
    found.light.nl <= 0 ? "The light is behind the surface."
      : found.light.shadow ? "Something is between point and light."
      : peak > limit ? `A peak, ${digits(peak)}, is beyond the edge.` : "",
  ].join(" ");
  const other = s.lobe === "phong" ? "blinnphong" : "phong";
  const legend = { lobe: LOBES[s.lobe].name, other: `${LOBES[other].name}, same p`, diffuse: "diffuse part" };
  find("#legend").innerHTML = Object.entries(legend).map(([kind, text]) =>
    `<li><svg viewBox="0 0 26 12" aria-hidden="true"><path class="${kind}" d="M1,6 H25"/></svg>${text}</li>`).join("");
  const { scale } = found.material, where = found.surface === "ball" ? "ball" : "board";
  find("#formula-note").innerHTML = [
    scale < 1 ? `${sub("ρ", "d")} + ${sub("ρ", "s")} would exceed 1: both are scaled by ${scale.toPrecision(3)}.` : "",
    !found.visible ? "The viewer does not see this point."
      : scale === 1 ? `A point of the ${where}; its pixel is the mean of four such points.` : "",
  ].join(" ");
}

const refresh = bindControls(state, change);
let speaking = 0;

// Change the settings, draw all, and tell it once nothing changes any more.
function change(edit) {
  edit();
  if (state.s.floor === "none" && state.s.point.on === "floor") state.s.point = copied(DEFAULTS.point);
  delete canvas.dataset.ready;
  clearTimeout(rest);
  world = compile(state.s);
  refresh();
  find("#xml").textContent = sceneXml(state.s);
  speak();
  if (!frame) {
    frame = requestAnimationFrame(() => {
      frame = 0;
      clearTimeout(rest);
      drawPoint();
      drawPicture();
    });
  }
}

function speak() {
  clearTimeout(speaking);
  speaking = setTimeout(() => {
    const found = examine(world, state.s, state.s.point, state.light);
    find("#spoken").textContent = spoken(found, state.s);
  }, 400);
}

// What the pointer or a key does on the picture -------------------------------------------------

const wrapped = (degrees) => ((((degrees + 180) % 360) + 360) % 360) - 180;

function turn(azimuth, elevation) {
  change(() => {
    const isLight = state.move === "light", at = isLight ? state.s.lights[state.light] : state.s;
    const [low, high] = isLight ? LIGHT_RANGES.elevation : RANGES.elevation;
    at.azimuth = wrapped(at.azimuth + azimuth);
    at.elevation = clamp(at.elevation + elevation, low, high);
  });
}

const hitAt = (x, y) => world.hit(world.camera.eye, world.camera.aim([0, 0, 0], x, y));

function placeOf(event) {
  const box = canvas.getBoundingClientRect();
  return [((event.clientX - box.left) * SIZE) / box.width, ((event.clientY - box.top) * SIZE) / box.height];
}

// The light moves to where its highlight is at this place.
function lightTo(x, y) {
  const hit = hitAt(x, y);
  if (!hit) return;
  const light = state.s.lights[state.light], d = mirrored(unit(minus(world.camera.eye, hit.p)), hit.n);
  const b = dot(hit.p, d), t = -b + Math.sqrt(Math.max(b * b - dot(hit.p, hit.p) + light.distance ** 2, 0));
  change(() => { [light.azimuth, light.elevation] = angles(add(hit.p, scaled(d, t))).map((a) => Math.round(10 * a) / 10); });
}

let grabbed = null;

function drag(event) {
  const place = placeOf(event);
  if (state.move === "view") turn(-0.4 * (place[0] - grabbed[0]), 0.4 * (place[1] - grabbed[1]));
  else if (state.move === "light") lightTo(...place);
  else pin(...place);
  grabbed = place;
}

function pin(x, y) {
  const hit = hitAt(x, y);
  if (hit) change(() => { state.s.point = pointOf(hit); });
}

canvas.addEventListener("pointerdown", (event) => {
  if (event.button !== 0) return;
  canvas.setPointerCapture(event.pointerId);
  grabbed = placeOf(event);
  state.probe = null;
  drag(event);
});
canvas.addEventListener("pointermove", (event) => {
  if (grabbed) return drag(event);
  if (event.pointerType !== "mouse") return;
  const hit = hitAt(...placeOf(event));
  state.probe = hit && pointOf(hit);
  drawPoint();
});
for (const kind of ["pointerup", "pointercancel"]) canvas.addEventListener(kind, () => { grabbed = null; });
canvas.addEventListener("pointerleave", () => {
  if (!state.probe) return;
  state.probe = null;
  drawPoint();
});

function step([dx, dy], far) {
  if (state.move === "point") {
    const [x, y] = world.camera.place(surfacePoint(state.s.point).p), length = far ? 24 : 4;
    pin(x + dx * length, y + dy * length);
  } else {
    // Around the ball to the right, or up.
    turn(dx * (far ? 10 : 2), -dy * (far ? 10 : 2));
  }
}

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const toHighlight = () => change(() => { state.s.point = highlightPoint(world, state.light); });
const KEYS = {
  q: () => change(() => { state.move = "point"; }),
  w: () => change(() => { state.move = "light"; }),
  e: () => change(() => { state.move = "view"; }),
  b: () => change(() => { state.s.lobe = state.s.lobe === "phong" ? "blinnphong" : "phong"; }),
  h: toHighlight,
};
canvas.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const number = Number(event.key), action = KEYS[event.key.toLowerCase()];
  if (ARROWS[event.key]) step(ARROWS[event.key], event.shiftKey);
  else if (action) action();
  else if (number >= 1 && number <= state.s.count) change(() => { state.light = number - 1; });
  else return;
  state.probe = null;
  event.preventDefault();
});

// Buttons ---------------------------------------------------------------------------------------

let forgetting = 0;

async function copy(text, what) {
  clearTimeout(forgetting);
  find("#copied").textContent = "";
  let done = true;
  try {
    await navigator.clipboard.writeText(text);
  } catch {
    // Where there is no clipboard for pages from files.
    const area = document.createElement("textarea");
    area.value = text;
    document.body.append(area);
    area.select();
    done = document.execCommand("copy");
    area.remove();
  }
  find("#copied").textContent = done ? `${what} copied` : "The browser forbids it";
  forgetting = setTimeout(() => { find("#copied").textContent = ""; }, 3000);
}

find("#copy").addEventListener("click", () => copy(sceneXml(state.s), "XML"));
find("#copy-link").addEventListener("click", () => {
  copy(`${location.href.split("#")[0]}#${toHash(state.s)}`, "Address");
});
find("#to-highlight").addEventListener("click", toHighlight);
find("#to-plane").addEventListener("click", () => change(() => {
  state.s.point = planePoint(world, state.light, state.s.point);
}));
find("#show-arrows").addEventListener("change", drawPoint);

function begin(s, words) {
  change(() => Object.assign(state, { s, light: 0, probe: null }));
  find("#words").innerHTML = words.replace(/\b([kL])_(\w)/g, "<i>$1</i><sub>$2</sub>");
}

const WELCOME = "Choose an example, move a slider, or click, tap or drag on the picture: "
  + "the plot and the formula are about that point.";
find("#reset").addEventListener("click", () => begin(copied(DEFAULTS), WELCOME));
for (const example of PRESETS) {
  const button = document.createElement("button");
  button.type = "button";
  button.textContent = example.name;
  button.addEventListener("click", () => begin(preset(example), example.words));
  find(".presets").append(button);
}
addEventListener("hashchange", () => begin(fromHash(location.hash), WELCOME));
begin(state.s, WELCOME);
