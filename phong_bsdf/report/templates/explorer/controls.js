// The form: what is typed and dragged there becomes settings, and the other way.
const find = (selector) => document.querySelector(selector);
const all = (selector) => [...document.querySelectorAll(selector)];

// p is 0 at the slider's left end, then grows from 0.1 to 1e6, a hundred steps each factor of 10.
const toSlider = { p: (p) => (p < 0.1 ? 0 : Math.round(100 * Math.log10(p)) + 100) };
const fromSlider = { p: (t) => (t === 0 ? 0 : Number((10 ** ((t - 100) / 100)).toPrecision(2))) };

// `change` is called with a function that changes the settings.
function bindControls(state, change) {
  const target = (name) => (name.startsWith("light.") ? [state.s.lights[state.light], name.slice(6)] : [state.s, name]);
  const range = (name) => (name.startsWith("light.") ? LIGHT_RANGES[name.slice(6)] : RANGES[name]);
  const set = (name, value) => change(() => { const [object, key] = target(name); object[key] = value; });

  for (const input of all("[data-range]")) {
    const name = input.dataset.range;
    input.addEventListener("input", () => set(name, (fromSlider[name] ?? Number)(Number(input.value))));
  }
  for (const input of all("[data-number]")) {
    const name = input.dataset.number;
    input.min = range(name)[0];
    input.max = range(name)[1];
    const valid = () => input.value !== "" && Number.isFinite(input.valueAsNumber);
    input.addEventListener("input", () => { if (valid() && input.checkValidity()) set(name, input.valueAsNumber); });
    // A step of a number is that of its slider.
    input.addEventListener("keydown", (event) => {
      if (event.key !== "ArrowUp" && event.key !== "ArrowDown") return;
      const slider = find(`[data-range="${name}"]`);
      slider[event.key === "ArrowUp" ? "stepUp" : "stepDown"]();
      slider.dispatchEvent(new Event("input"));
      show(input);
      event.preventDefault();
    });
    // What is out of range becomes the nearest that is not.
    input.addEventListener("change", () => {
      if (valid()) set(name, clamp(input.valueAsNumber, ...range(name)));
      show(input);
    });
  }
  for (const name of ["lobe", "terms", "floor", "display"]) {
    for (const radio of all(`[name="${name}"]`)) radio.addEventListener("change", () => set(name, radio.value));
  }
  for (const radio of all('[name="count"]')) {
    radio.addEventListener("change", () => change(() => {
      state.s.count = Number(radio.value);
      state.light = Math.min(state.light, state.s.count - 1);
    }));
  }
  const choose = (name, convert) => all(`[name="${name}"]`).forEach((radio) => {
    radio.addEventListener("change", () => change(() => { state[name] = convert(radio.value); }));
  });
  choose("light", Number);
  choose("move", String);
  find("#colour").addEventListener("input", (event) => set("colour", event.target.value));
  find("#light-colour").addEventListener("input", (event) => set("light.colour", event.target.value));
  find("#falloff").addEventListener("change", (event) => set("falloff", event.target.checked));

  function show(input) {
    const [object, key] = target(input.dataset.number), value = object[key];
    input.value = String(Number(value.toFixed(key === "p" ? 6 : 3)));
  }

  return function refresh() {
    const { s } = state, light = s.lights[state.light];
    for (const input of all("[data-range]")) {
      const [object, key] = target(input.dataset.range);
      input.value = (toSlider[key] ?? Number)(object[key]);
      input.setAttribute("aria-valuetext", brief(object[key]));
    }
    for (const input of all("[data-number]")) if (input !== document.activeElement) show(input);
    for (const [name, value] of Object.entries({ ...s, light: state.light, move: state.move })) {
      for (const radio of all(`input[type="radio"][name="${name}"]`)) radio.checked = radio.value === String(value);
    }
    all('[name="light"]').forEach((radio, i) => { radio.disabled = i >= s.count; });
    find("#colour").value = s.colour;
    find("#light-colour").value = light.colour;
    find("#colour-text").textContent = channels(s.colour).map((x) => x.toFixed(2)).join(", ");
    find("#light-colour-text").textContent = channels(light.colour).map((x) => x.toFixed(2)).join(", ");
    find("#falloff").checked = s.falloff;
    for (const letter of all("[data-k]")) letter.textContent = s.terms === "physical" ? "ρ" : "k";
  };
}
