"use strict";
/* A cursor over all panels with the same horizontal axis, dots on the tracks, and zoom. Paths are in counts, see
   plot.py: what is read at the cursor are the samples that are drawn, to their printed digits. */
const panels = [...document.querySelectorAll("svg.panel")].map(open);
let cursor = null; // time of the cursor and its panel

function open(svg) {
  const plot = svg.querySelector("svg"), label = svg.querySelector(".label").textContent;
  const [x, y, width, height] = ["x", "y", "width", "height"].map(name => +plot.getAttribute(name));
  const groups = [...plot.querySelectorAll("g")], home = groups.map(group => numbers(group.getAttribute("transform")));
  const [digits, factor] = numbers(svg.dataset.x), ticks = svg.querySelector(".ticks"), unit = label.match(/\[(.*)\]/)?.[1];
  const panel = {
    svg, plot, x, y, width, height, groups, home, digits, factor, ticks, labels: ticks.innerHTML,
    view: [home[0][0], home[0][4]], // scale and offset from counts to places across
    unit: factor === 1 ? unit ?? "" : "s",
    track: svg.querySelector("[data-t]"),
    axis: factor && label.startsWith("time [") ? `${label} ${home[0]}` : svg,
  };
  listen(panel, svg.closest("a"));
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
    name: path.dataset.name, style: [...path.classList].slice(1).join(" "), kinds: path.classList, samples: samples(path, digits),
    band: [...svg.querySelectorAll(`.band.${path.classList[1]}`)].flatMap(edges => samples(edges)),
  })).filter(line => line.samples.length));
}

function nearest(found, time) {
  return found.reduce((best, one) => (Math.abs(one.time - time) < Math.abs(best.time - time) ? one : best));
}

/** A count to its printed digits: three on a logarithmic axis. */
function written(count, reading) {
  const decimals = parseInt(reading);
  return reading === "log" ? String(+(10 ** (count / 5000)).toPrecision(3)) : (count / 10 ** decimals).toFixed(Math.max(decimals, 0));
}

/** A line's value at a sample, its band, and where this is. */
function reading({ svg, track, unit }, { name, kinds, band }, { x, y, time }) {
  const [value, across] = [written(y, svg.dataset.y), written(x, svg.dataset.x)];
  if (track) return kinds.contains("magnified") ? "" : `${name} ${value} north, ${across} east at ${time.toFixed(2)} s`;
  const edges = kinds.length > 2 ? [] : band.filter(edge => edge.x === x).map(edge => written(edge.y, svg.dataset.y));
  const [high, low] = [edges[0], edges.at(-1)];
  return `${name} ${value}${!high ? "" : low === `-${high}` ? ` \u00b1${high}` : ` (${low} to ${high})`} at ${across} ${unit}`.trim();
}

/** Show the cursor in all panels with the axis of this one; at a time, with dots on the tracks. */
function show(panel, time) {
  hide();
  cursor = { panel, time };
  const { axis } = panel.track ? panels.find(other => typeof other.axis === "string") ?? panel : panel;
  for (const other of panels) if (other === panel || other.axis === axis || (other.track && typeof axis === "string")) draw(other, time);
}

function draw(panel, time) {
  const { svg, plot, x, y, width, height, track } = panel, [scale, offset] = panel.view, [, , , down, , top] = panel.home[1];
  const shown = lines(panel).map(line => ({ ...line, one: nearest(line.samples, time) }))
    .filter(({ kinds, one }) => kinds[0] === "line" || Math.abs(one.time - time) * scale * 10 ** (panel.digits ?? 0) < 3);
  if (!shown.length) return;
  const place = nearest(shown.map(({ one }) => one), time).x * scale + offset, right = place < x + width / 2;
  const group = plot.appendChild(document.createElementNS(svg.namespaceURI, "g"));
  group.setAttribute("class", "cursor");
  group.innerHTML = track ? "" : `<path d="M${place} ${y}v${height}"/>`;
  let row = 0;
  for (const line of shown) {
    const text = reading(panel, line, line.one), at = `x="${right ? x + width - 4 : x + 4}" y="${y + 13 * (row + 1)}"`;
    group.insertAdjacentHTML("beforeend", `<circle class="${line.style}" cx="${line.one.x * scale + offset}" cy="${line.one.y * down + top}" r="3"/>`);
    if (!text) continue;
    group.insertAdjacentHTML("beforeend", `<text class="${line.style}" ${at} text-anchor="${right ? "end" : "start"}"/>`);
    group.lastChild.textContent = text;
    row += 1;
  }
  svg.classList.add("read");
}

function hide() {
  cursor = null;
  document.querySelectorAll(".cursor").forEach(group => group.remove());
  document.querySelectorAll(".read").forEach(svg => svg.classList.remove("read"));
}

/** Show counts from low to high in all panels with this axis; without them everything. */
function zoom({ axis }, low, high) {
  for (const panel of panels.filter(panel => panel.axis === axis)) {
    const { svg, x, width, groups, home, ticks, labels } = panel, scale = width / (high - low), zoomed = low !== undefined;
    panel.view = zoomed ? [scale, x - low * scale] : [home[0][0], home[0][4]];
    groups.forEach((group, i) => group.setAttribute("transform", `matrix(${home[i].with(0, panel.view[0]).with(4, panel.view[1]).join(" ")})`));
    ticks.innerHTML = zoomed ? zoomedTicks(panel, low, high) : labels;
    svg.classList.toggle("zoomed", zoomed);
  }
}

function zoomedTicks({ y, height, digits, factor, view }, low, high) {
  const size = 10 ** digits * factor, rough = (high - low) / size / 6, power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 2.5, 5, 10].find(digit => digit * power >= rough);
  let drawn = "";
  for (let i = Math.ceil(low / size / step); i * step * size <= high; i++) {
    const x = i * step * size * view[0] + view[1];
    drawn += `<path class="grid" d="M${x} ${y}v${height}"/>
      <text class="tick" x="${x}" y="${y + height + 13}" text-anchor="middle">${+(i * step).toPrecision(9)}</text>`;
  }
  return drawn;
}

function listen(panel, link) {
  const { svg, x: left, y: top, width, height } = panel, down = { from: null, moved: false, click: 0 };
  const place = event => new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
  const count = x => (Math.min(Math.max(x, left), left + width) - panel.view[1]) / panel.view[0];
  const on = (names, act) => names.split(" ").forEach(name => link.addEventListener(name, act));
  link.removeAttribute("title");
  on("dragstart", event => event.preventDefault());
  on("pointerdown", event => {
    const zooms = event.pointerType !== "touch" && panel.factor && !panel.track;
    Object.assign(down, { from: zooms ? place(event).x : null, moved: false });
  });
  on("pointermove", event => {
    const { x, y } = place(event), [scale, offset] = panel.view, matrix = panel.home[1];
    const far = one => Math.hypot(one.x * scale + offset - x, panel.track ? one.y * matrix[3] + matrix[5] - y : 0);
    const all = lines(panel).flatMap(line => line.samples);
    if (all.length) show(panel, all.reduce((best, one) => (far(one) < far(best) ? one : best)).time);
    if (down.from === null || (!down.moved && Math.abs(x - down.from) < 5)) return;
    down.moved = true;
    link.setPointerCapture(event.pointerId);
    svg.querySelector(".cursor")?.insertAdjacentHTML("beforeend",
      `<rect x="${Math.min(x, down.from)}" y="${top}" width="${Math.abs(x - down.from)}" height="${height}"/>`);
  });
  on("pointerup pointercancel", event => {
    const ends = [down.from, place(event).x].map(count).sort((a, b) => a - b);
    if (down.moved && event.type === "pointerup" && ends[0] < ends[1]) zoom(panel, ...ends);
    down.from = null;
  });
  on("pointerleave", event => event.pointerType === "touch" || hide());
  on("click", event => {
    // A click enlarges the panel. If it is zoomed, this waits, since a second click shows everything again.
    const waits = event.detail && svg.classList.contains("zoomed");
    if (down.moved || waits) event.preventDefault();
    clearTimeout(down.click);
    if (waits && !down.moved && event.detail === 1) down.click = setTimeout(() => (location.href = link.href), 250);
  });
  on("dblclick", () => zoom(panel));
  on("keydown", event => {
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key], found = lines(panel)[0]?.samples;
    if (event.key === "Escape") hide();
    if (!step || !found) return;
    event.preventDefault();
    const last = cursor?.panel === panel ? found.indexOf(nearest(found, cursor.time)) + step : 0;
    show(panel, found[Math.min(Math.max(last, 0), found.length - 1)].time);
  });
}
