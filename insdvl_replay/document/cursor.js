"use strict";
/* A cursor over all panels with the same horizontal axis, dots on the tracks, and zoom. Paths are in counts, see
   plot.py: what is read at the cursor are the samples that are drawn, to their printed digits. */
const ROW = 13, NEAR = 3, DRAG = 5, WAIT_MS = 400, LOG_COUNTS = 5000, CLOSE = 5;
const panels = [...document.querySelectorAll("svg.panel")].map(open);
let cursor = null; // panel and time

function open(svg) {
  const plot = svg.querySelector("svg"), groups = [...plot.querySelectorAll("g")], ticks = svg.querySelector(".ticks");
  const [x, y, width, height] = ["x", "y", "width", "height"].map(name => +plot.getAttribute(name));
  const home = groups.map(group => numbers(group.getAttribute("transform")));
  const [digits, factor] = numbers(svg.dataset.x); // none on a logarithmic axis
  const label = svg.querySelector(".label").textContent, unit = label.match(/\[(.*)\]/)?.[1] ?? "";
  const panel = {
    svg, plot, groups, ticks, x, y, width, height, home, digits, factor,
    view: [home[0][0], home[0][4]], // scale and offset from counts to places across
    labels: ticks.innerHTML,
    unit: factor > 1 ? "s" : unit,
    track: svg.querySelector("[data-t]"),
    clock: label.startsWith("time [") ? `${label} ${svg.dataset.x} ${home[0]}` : "", // linked panels have the same
  };
  listen(panel, svg.closest("a") ?? svg);
  return panel;
}

function numbers(text) {
  return (text?.match(/-?[\d.]+(e-?\d+)?/g) ?? []).map(Number);
}

/** Samples of a path: M begins at a place, l are steps. */
function samples(path, digits) {
  const found = [];
  let x = 0, y = 0, time = 0;
  for (const [, command, text] of path.getAttribute("d").matchAll(/([Ml])([^A-Za-z]*)/g)) {
    const values = numbers(text);
    for (let i = 0; i < values.length; i += 2) {
      [x, y] = command === "M" ? [values[i], values[i + 1]] : [x + values[i], y + values[i + 1]];
      found.push({ x, y, time: digits === undefined ? x : x / 10 ** digits });
    }
  }
  numbers(path.dataset.t).forEach((step, i) => (found[i].time = (time += step) / 100));
  return found;
}

/** Lines of a panel, read when they are first needed. */
function lines({ svg, digits }) {
  return (svg.lines ??= [...svg.querySelectorAll("[data-name]:not([data-name=''])")].map(path => ({
    name: path.dataset.name, kinds: [...path.classList], samples: samples(path, digits),
    band: [...svg.querySelectorAll(`.band.${path.classList[1]}`)].flatMap(edges => samples(edges)),
  })).filter(line => line.samples.length));
}

function nearest(found, time) {
  return found.reduce((best, one) => (Math.abs(one.time - time) < Math.abs(best.time - time) ? one : best));
}

/** A count to its printed digits: three on a logarithmic axis. */
function written(count, reading) {
  if (reading === "log") return String(+(10 ** (count / LOG_COUNTS)).toPrecision(3));
  const decimals = parseInt(reading);
  return (count / 10 ** decimals).toFixed(Math.max(decimals, 0));
}

/** The text for a line at a sample: its value, its band, and where this is. */
function reading({ svg, track, unit }, { name, kinds, band }, { x, y, time }) {
  const [value, across] = [written(y, svg.dataset.y), written(x, svg.dataset.x)];
  if (kinds.includes("magnified")) return "";
  if (track) return `${name} ${value} north, ${across} east at ${time.toFixed(2)} s`;
  const edges = band.filter(edge => kinds.length === 2 && edge.x === x).map(edge => written(edge.y, svg.dataset.y));
  const high = edges[0], low = edges.at(-1), around = low === `-${high}` ? `\u00b1${high}` : `(${low} to ${high})`;
  return `${name} ${value} ${high ? `${around} ` : ""}at ${across} ${unit}`.trim();
}

/** Show the cursor in a panel and those that are linked with it; tracks are linked with the time of the dive. */
function show(panel, time) {
  hide();
  cursor = { panel, time };
  const { clock, factor } = panel.track ? panels.find(other => other.clock && other.factor) ?? panel : panel;
  panels.filter(other => other === panel || (clock && (other.clock === clock || (other.track && factor))))
    .forEach(other => draw(other, time));
}

function draw(panel, time) {
  const { svg, plot, x, y, width, height } = panel, [scale, offset] = panel.view, [, , , down, , top] = panel.home[1];
  const reach = NEAR / scale / 10 ** (panel.digits ?? 0); // separate points are read if they are near
  const shown = lines(panel).map(line => ({ line, sample: nearest(line.samples, time) }))
    .filter(({ line, sample }) => line.kinds[0] === "line" || Math.abs(sample.time - time) < reach);
  if (!shown.length) return;
  const across = nearest(shown.map(({ sample }) => sample), time).x * scale + offset;
  const [edge, anchor] = across < x + width / 2 ? [x + width - 4, "end"] : [x + 4, "start"];
  const group = plot.appendChild(document.createElementNS(svg.namespaceURI, "g"));
  const add = shape => group.insertAdjacentHTML("beforeend", shape);
  group.setAttribute("class", "cursor");
  if (!panel.track) add(`<path d="M${across} ${y}v${height}"/>`);
  for (const { line, sample } of shown) {
    const style = line.kinds.slice(1).join(" "), text = reading(panel, line, sample);
    add(`<circle class="${style}" cx="${sample.x * scale + offset}" cy="${sample.y * down + top}" r="3"/>`);
    if (!text) continue;
    const row = y + ROW * (group.querySelectorAll("text").length + 1);
    add(`<text class="${style}" x="${edge}" y="${row}" text-anchor="${anchor}"/>`);
    group.lastChild.textContent = text;
  }
  svg.classList.add("read");
}

function hide() {
  cursor = null;
  document.querySelectorAll(".cursor").forEach(group => group.remove());
  document.querySelectorAll(".read").forEach(svg => svg.classList.remove("read"));
}

/** Show counts from low to high in a panel and those that are linked with it; without them everything. */
function zoom(panel, low, high) {
  for (const other of panels.filter(other => other === panel || (panel.clock && other.clock === panel.clock))) {
    const { svg, x, width, groups, home, ticks, labels } = other;
    const zoomed = low !== undefined, scale = width / (high - low);
    const [across, left] = (other.view = zoomed ? [scale, x - low * scale] : [home[0][0], home[0][4]]);
    groups.forEach((group, i) => {
      const [, , , down, , top] = home[i];
      group.setAttribute("transform", `matrix(${across} 0 0 ${down} ${left} ${top})`);
    });
    ticks.innerHTML = zoomed ? zoomedTicks(other, low, high) : labels;
    svg.classList.toggle("zoomed", zoomed);
  }
}

/** Ticks at round values: on a logarithmic axis at 1, 2 and 5, or as on a linear one between values that are close. */
function zoomedTicks({ y, height, digits, factor, view }, low, high) {
  const size = 10 ** digits * factor; // counts of a unit, on a linear axis
  const [first, last] = [low, high].map(count => (factor ? count / size : 10 ** (count / LOG_COUNTS)));
  const rough = (last - first) / 6, power = 10 ** Math.floor(Math.log10(rough)), values = [];
  const step = power * [1, 2, 2.5, 5, 10].find(digit => digit * power >= rough);
  if (factor || last < CLOSE * first) {
    for (let i = Math.ceil(first / step); i * step <= last; i++) values.push(i * step);
  } else {
    for (let decade = 10 ** Math.floor(Math.log10(first)); decade <= last; decade *= 10) {
      values.push(...[1, 2, 5].map(digit => digit * decade).filter(value => value >= first && value <= last));
    }
  }
  return values.map(value => {
    const x = (factor ? value * size : LOG_COUNTS * Math.log10(value)) * view[0] + view[1];
    return `<path d="M${x} ${y}v${height}"/><text x="${x}" y="${y + height + ROW}">${+value.toPrecision(9)}</text>`;
  }).join("");
}

function listen(panel, link) {
  const { svg, x: left, y: top, width, height } = panel;
  const on = (names, act) => names.split(" ").forEach(name => link.addEventListener(name, act));
  const place = event => new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
  const count = x => (Math.min(Math.max(x, left), left + width) - panel.view[1]) / panel.view[0];
  let from = null, dragged = false, waiting = 0; // a drag of the mouse; a click that may become a double click
  link.removeAttribute("title");
  on("dragstart", event => event.preventDefault());
  on("pointerdown", event => {
    dragged = false;
    from = event.pointerType !== "touch" && !panel.track ? place(event).x : null;
  });
  on("pointermove", event => {
    const { x, y } = place(event), [scale, offset] = panel.view, [, , , down, , bottom] = panel.home[1];
    const away = one => [one.x * scale + offset - x, panel.track ? one.y * down + bottom - y : 0];
    const far = one => Math.hypot(...away(one)), all = lines(panel).flatMap(line => line.samples);
    if (all.length) show(panel, all.reduce((best, one) => (far(one) < far(best) ? one : best)).time);
    if (from === null || (!dragged && Math.abs(x - from) < DRAG)) return;
    dragged = true;
    link.setPointerCapture(event.pointerId);
    const stretch = `x="${Math.min(x, from)}" y="${top}" width="${Math.abs(x - from)}" height="${height}"`;
    svg.querySelector(".cursor")?.insertAdjacentHTML("beforeend", `<rect ${stretch}/>`);
  });
  on("pointerup pointercancel", event => {
    const [low, high] = [from, place(event).x].map(count).sort((a, b) => a - b);
    if (dragged && event.type === "pointerup" && low < high) zoom(panel, low, high);
    from = null;
  });
  on("pointerleave", event => event.pointerType === "touch" || hide());
  on("click", event => {
    // A click enlarges the panel. In a zoomed one it waits: a second click shows everything again.
    const waits = event.detail && svg.classList.contains("zoomed");
    if (dragged || waits) event.preventDefault();
    clearTimeout(waiting);
    if (waits && !dragged && event.detail === 1) waiting = setTimeout(() => (location.href = link.href), WAIT_MS);
  });
  on("dblclick", () => zoom(panel));
  on("keydown", event => {
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key], found = lines(panel)[0]?.samples;
    if (event.key === "Escape") hide();
    if (!step || !found) return;
    event.preventDefault();
    const next = cursor?.panel === panel ? found.indexOf(nearest(found, cursor.time)) + step : 0;
    show(panel, found[Math.min(Math.max(next, 0), found.length - 1)].time);
  });
}
