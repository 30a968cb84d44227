"use strict";
// The picture viewer. Pixels are half floats, so that exposure and values are those of the rendering.
(async () => {
  const root = document.getElementById("viewer");
  const data = JSON.parse(document.getElementById("viewer-data").textContent);
  const control = (name) => root.querySelector(`[data-control="${name}"]`);
  const buttons = [...root.querySelectorAll("[data-picture]")];
  const stage = root.querySelector(".stage");
  const canvas = root.querySelector("canvas");
  const [mode, wipe, exposure, zoom] = ["mode", "wipe", "exposure", "zoom"].map(control);
  const { width, height } = data.pictures[0];
  let shown = 0;
  let pixel = null;

  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const colours = bytes(data.colours);

  function halfToFloat(h) {
    const sign = h & 0x8000 ? -1 : 1, exponent = (h >> 10) & 31, fraction = h & 1023;
    if (exponent === 0) return sign * fraction * 2 ** -24;
    if (exponent === 31) return fraction ? NaN : sign * Infinity;
    return sign * (1024 + fraction) * 2 ** (exponent - 25);
  }
  const floats = Float32Array.from({ length: 65536 }, (_, h) => halfToFloat(h) * data.scale);

  async function decode(picture) {
    const stream = new Blob([bytes(picture.data)]).stream().pipeThrough(new DecompressionStream("deflate"));
    const halves = new Uint16Array(await new Response(stream).arrayBuffer());
    const pixels = new Float32Array(3 * width * height);
    for (let i = 0; i < pixels.length; i++) {
      pixels[i] = floats[halves[picture.channels === 3 ? i : Math.floor(i / 3)]];
    }
    return pixels;
  }

  // sRGB of x in [0, 1], from a table fine enough for 8 bits.
  const curve = Uint8ClampedArray.from({ length: 16385 }, (_, i) => {
    const x = i / 16384;
    return Math.round(255 * (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055));
  });
  const encode = (x) => curve[x > 0 ? (x < 1 ? Math.round(16384 * x) : 16384) : 0];

  function draw() {
    const gain = 2 ** exposure.value, picture = images[shown], first = images[data.pictures[shown].against];
    const split = mode.value === "wipe" ? Math.round((width * wipe.value) / 100) : 0;
    const out = frame.data;
    for (let i = 0; i < width * height; i++) {
      const j = 3 * i, k = 4 * i;
      if (mode.value === "difference") {
        let sum = 0;
        for (let c = 0; c < 3; c++) sum += Math.abs(picture[j + c] - first[j + c]);
        const share = (gain * sum) / (3 * data.difference);
        const at = 3 * (share < 1 ? Math.round(255 * share) : 255);
        for (let c = 0; c < 3; c++) out[k + c] = colours[at + c];
      } else {
        const source = i % width < split ? first : picture;
        for (let c = 0; c < 3; c++) out[k + c] = encode(gain * source[j + c]);
      }
      out[k + 3] = 255;
    }
    context.putImageData(frame, 0, 0);
    if (split > 0 && split < width) {
      context.fillStyle = "#fff";
      context.fillRect(split, 0, 1, height);
    }
    mark();
  }

  function mark() {
    if (!pixel || document.activeElement !== stage) return;
    context.strokeStyle = "#f0f";
    context.strokeRect(pixel[0] - 0.5, pixel[1] - 0.5, 2, 2);
  }

  function say() {
    if (!pixel) return;
    const at = 3 * (pixel[1] * width + pixel[0]);
    const length = Math.max(...data.pictures.map((picture) => picture.name.length));
    const lines = data.pictures.map((picture, i) =>
      picture.name.padEnd(length) + [0, 1, 2].map((c) => "  " + images[i][at + c].toPrecision(4)).join(""));
    control("pixel").textContent = `x ${pixel[0]}, y ${pixel[1]}\n${lines.join("\n")}`;
  }

  function show(index) {
    if (index >= images.length) return;
    shown = index;
    buttons.forEach((button, i) => button.setAttribute("aria-pressed", i === index));
    draw();
  }

  function setExposure(stops) {
    exposure.value = stops;
    control("stops").textContent = (exposure.value < 0 ? "" : "+") + exposure.value;
    draw();
  }

  function setZoom() {
    canvas.style.width = zoom.value === "0" ? `min(100%, ${(85 * width) / height}vh)` : `${zoom.value * width}px`;
  }

  function step(select, by) {
    select.selectedIndex = Math.min(Math.max(select.selectedIndex + by, 0), select.length - 1);
    setZoom();
  }

  const toggle = (value) => { mode.value = mode.value === value ? "picture" : value; draw(); };
  const keys = {
    w: () => toggle("wipe"), d: () => toggle("difference"),
    e: () => setExposure(+exposure.value + 0.5), E: () => setExposure(+exposure.value - 0.5), 0: () => setExposure(0),
    r: () => show(data.pictures[shown].against), "+": () => step(zoom, 1), "=": () => step(zoom, 1), "-": () => step(zoom, -1),
  };
  const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

  function press(event) {
    // A list uses all keys itself.
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.matches("select")) return;
    if (/^[1-9]$/.test(event.key)) return show(event.key - 1);
    if (event.key in keys) keys[event.key]();
    else if (event.key in arrows && document.activeElement === stage) {
      const [x, y] = pixel || [width >> 1, height >> 1], [dx, dy] = pixel ? arrows[event.key] : [0, 0];
      pixel = [Math.min(Math.max(x + dx, 0), width - 1), Math.min(Math.max(y + dy, 0), height - 1)];
      say();
      draw();
    } else return;
    event.preventDefault();
  }

  function point(event) {
    const box = canvas.getBoundingClientRect();
    const x = Math.floor(((event.clientX - box.left) / box.width) * width);
    const y = Math.floor(((event.clientY - box.top) / box.height) * height);
    if (x < 0 || y < 0 || x >= width || y >= height) return;
    pixel = [x, y];
    say();
  }

  canvas.width = width;
  canvas.height = height;
  const context = canvas.getContext("2d", { willReadFrequently: true });
  const frame = context.createImageData(width, height);
  const images = await Promise.all(data.pictures.map(decode));
  buttons.forEach((button, i) => button.addEventListener("click", () => show(i)));
  mode.addEventListener("input", draw);
  wipe.addEventListener("input", () => { mode.value = "wipe"; draw(); });
  exposure.addEventListener("input", () => setExposure(exposure.value));
  zoom.addEventListener("input", setZoom);
  canvas.addEventListener("pointermove", point);
  canvas.addEventListener("pointerdown", point);
  document.addEventListener("keydown", press);
  setZoom();
  draw();
  root.dataset.ready = "true";
})();
