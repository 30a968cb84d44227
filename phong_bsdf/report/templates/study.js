"use strict";
// Tables that sort, and plots that say the values of the point nearest to the mouse.
(() => {
  const value = (row, column) => {
    const cell = row.cells[column], number = cell.dataset.value;
    if (number === undefined) return cell.textContent;
    return number === "inf" ? Infinity : Number(number);
  };
  // Numbers before words, empty cells last, whichever way the table is sorted.
  const rank = (x) => (typeof x === "number" ? 0 : x === "-" || x === "" ? 2 : 1);

  function sort(table, column, up) {
    const rows = [...table.tBodies[0].rows];
    rows.sort((a, b) => {
      const [x, y] = [value(a, column), value(b, column)];
      if (rank(x) !== rank(y)) return rank(x) - rank(y);
      const order = typeof x === "number" ? (x > y) - (x < y) : x.localeCompare(y);
      return up ? order : -order;
    });
    table.tBodies[0].append(...rows);
    [...table.tHead.rows[0].cells].forEach((cell, i) => {
      if (i === column) cell.setAttribute("aria-sort", up ? "ascending" : "descending");
      else cell.removeAttribute("aria-sort");
    });
  }

  for (const table of document.querySelectorAll("table.sortable")) {
    [...table.tHead.rows[0].cells].forEach((cell, column) => {
      const button = document.createElement("button");
      button.type = "button";
      button.append(...cell.childNodes);
      cell.append(button);
      button.addEventListener("click", () => sort(table, column, cell.getAttribute("aria-sort") !== "ascending"));
    });
  }

  const figures = [...document.querySelectorAll("[data-plot]")];
  const choice = document.querySelector('[data-control="plot"]');
  const readout = document.querySelector(".readout");
  const switches = [...document.querySelectorAll("[data-curve]")];
  const points = (figure) =>
    [...figure.querySelectorAll('[id^="point-"]')].filter((point) => point.style.display !== "none");

  function show() {
    figures.forEach((figure) => { figure.hidden = figure.dataset.plot !== choice.value; });
  }

  function say(figure, point) {
    figure.querySelectorAll(".near").forEach((other) => other.classList.remove("near"));
    if (!point) return;
    point.classList.add("near");
    readout.textContent = point.querySelector("title").textContent;
  }

  const middle = (element) => {
    const box = element.getBoundingClientRect();
    return [box.left + box.width / 2, box.top + box.height / 2];
  };

  function near(figure, event) {
    let best = null, distance = 40;
    for (const point of points(figure)) {
      const [x, y] = middle(point), d = Math.hypot(x - event.clientX, y - event.clientY);
      if (d < distance) [best, distance] = [point, d];
    }
    if (best) say(figure, best);
  }

  for (const figure of figures) {
    figure.addEventListener("pointermove", (event) => near(figure, event));
    figure.addEventListener("pointerdown", (event) => near(figure, event));
    figure.addEventListener("keydown", (event) => {
      const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
      if (!step) return;
      const all = points(figure), at = all.findIndex((point) => point.classList.contains("near"));
      say(figure, all[at < 0 ? 0 : (at + step + all.length) % all.length]);
      event.preventDefault();
    });
  }
  switches.forEach((button) => button.addEventListener("click", () => {
    const shown = button.getAttribute("aria-pressed") !== "true";
    button.setAttribute("aria-pressed", shown);
    for (const part of document.querySelectorAll(`[data-plot] [id$="-curve${button.dataset.curve}"]`)) {
      part.style.display = shown ? "" : "none";
    }
  }));
  choice.addEventListener("input", show);
  show();
})();
