// The run so far. A row is [time_s, light, outcome, x_cm, y_cm, fitness]; without a stem the last three are null.
import { drawTask } from "./overlay.js";
import { pathOf, shape, tickText, ticks } from "./svg.js";

const TIME = 0, LIGHT = 1, X = 3, Y = 4, FITNESS = 5;
const EDGE = { left: 40, right: 18, top: 8, bottom: 20 };
const MOST_DRAWN = 3000;
let pointer = null; // where it is over a chart, so that a new row does not take its words away
const GAP = 2.5; // beats without a photograph, and the line is broken

function sized(svg) {
  const { width, height } = svg.getBoundingClientRect();
  svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
  svg.replaceChildren();
  return [width, height];
}

// Every so many rows, and always the last.
function thinned(rows) {
  const every = Math.ceil(rows.length / MOST_DRAWN);
  return every <= 1 ? rows : rows.filter((_, i) => i % every === 0 || i === rows.length - 1);
}

// Pieces of a line, broken where there was no stem for some beats.
function pieces(rows, interval, point) {
  const found = [];
  let last = -Infinity;
  for (const row of rows) {
    const at = point(row);
    if (!at) continue;
    if (row[TIME] - last > GAP * interval) found.push([]);
    found.at(-1).push(at);
    last = row[TIME];
  }
  return found;
}

function drawLine(svg, parts) {
  for (const part of parts) {
    if (part.length > 1) svg.append(shape("path", { class: "course", d: pathOf(part) }));
    else svg.append(shape("circle", { class: "tip", cx: part[0][0], cy: part[0][1], r: 1.2 }));
  }
}

export function drawPath(svg, rows, view) {
  const [width, height] = sized(svg);
  const { target, obstacle } = view;
  const xs = [-4, 4], ys = [0, 8];
  for (const row of rows) if (row[X] !== null) { xs.push(row[X]); ys.push(row[Y]); }
  if (target) { xs.push(target.x_cm - target.radius_cm, target.x_cm + target.radius_cm); ys.push(target.y_cm + target.radius_cm); }
  if (obstacle) { xs.push(obstacle.x_cm - obstacle.width_cm / 2, obstacle.x_cm + obstacle.width_cm / 2); ys.push(obstacle.y_cm + obstacle.height_cm / 2); }
  const low = [least(xs) - 0.5, Math.min(0, least(ys))], high = [most(xs) + 0.5, most(ys) + 0.5];
  const inner = [width - EDGE.left - EDGE.right, height - EDGE.top - EDGE.bottom];
  const scale = Math.max(1e-6, Math.min(inner[0] / (high[0] - low[0]), inner[1] / (high[1] - low[1])));
  const middle = (low[0] + high[0]) / 2;
  const place = ([x, y]) => [EDGE.left + inner[0] / 2 + (x - middle) * scale, EDGE.top + inner[1] - (y - low[1]) * scale];
  for (const y of ticks(low[1], high[1], 5)) {
    const at = place([0, y])[1];
    svg.append(shape("line", { class: "grid", x1: EDGE.left, x2: width - EDGE.right, y1: at, y2: at }));
    svg.append(shape("text", { class: "tick", x: EDGE.left - 6, y: at + 4, "text-anchor": "end" }, tickText(y)));
  }
  for (const x of ticks(low[0], high[0], 4)) {
    svg.append(shape("text", { class: "tick", x: place([x, 0])[0], y: height - 5, "text-anchor": "middle" }, tickText(x)));
  }
  drawTask(svg, view, place, scale);
  drawLine(svg, pieces(thinned(rows), view.interval_s, (row) => (row[X] === null ? null : place([row[X], row[Y]]))));
  const stem = view.last.stem?.message;
  if (stem?.points_cm.length) {
    const points = stem.points_cm.map(place);
    svg.append(shape("path", { class: "stem under", d: pathOf(points) }), shape("path", { class: "stem", d: pathOf(points) }));
    svg.append(shape("circle", { class: "tip", cx: points.at(-1)[0], cy: points.at(-1)[1], r: 4 }));
  }
}

export function drawCourses(svgs, rows, view, told) {
  const kinds = [
    { of: (row) => row[X], name: "right", unit: "cm", goal: view.target?.x_cm ?? null, least: [-2, 2] },
    { of: (row) => row[Y], name: "up", unit: "cm", goal: view.target?.y_cm ?? null, least: [0, 5] },
    { of: (row) => (row[FITNESS] === null ? null : 100 * row[FITNESS]), name: "fitness", unit: "%", goal: null, least: [0, 100] },
  ];
  const first = rows.length ? rows[0][TIME] / 3600 : 0;
  const last = Math.max(first + 0.5, rows.length ? rows.at(-1)[TIME] / 3600 : 0);
  svgs.forEach((svg, i) => drawCourse(svg, rows, view, kinds[i], first, last));
  const show = () => pointer && pointAt(pointer, svgs, rows, kinds, first, last, told);
  for (const svg of svgs) {
    svg.onpointermove = (event) => { pointer = { svg, x: event.clientX }; show(); };
    svg.onpointerleave = () => { pointer = null; told.textContent = ""; svgs.forEach((one) => one.querySelector(".cursor")?.remove()); };
  }
  show();
}

const across = (width, first, last) => (hour) => EDGE.left + ((hour - first) / (last - first)) * (width - EDGE.left - EDGE.right);

function drawCourse(svg, rows, view, kind, first, last) {
  const [width, height] = sized(svg);
  const x = across(width, first, last);
  const values = rows.map(kind.of).filter((value) => value !== null);
  let low = Math.min(kind.least[0], least(values)), high = Math.max(kind.least[1], most(values));
  if (kind.goal !== null) { low = Math.min(low, kind.goal); high = Math.max(high, kind.goal); }
  const room = 0.05 * (high - low);
  const y = (value) => EDGE.top + ((high + room - value) / (high - low + 2 * room)) * (height - EDGE.top - EDGE.bottom);
  for (const [light, from, to] of bands(rows)) {
    svg.append(shape("rect", { class: `band ${light}`, x: x(from), y: EDGE.top, width: Math.max(0.5, x(to) - x(from)), height: height - EDGE.top - EDGE.bottom }));
  }
  for (const value of ticks(low, high, 3)) {
    svg.append(shape("line", { class: "grid", x1: EDGE.left, x2: width - EDGE.right, y1: y(value), y2: y(value) }));
    svg.append(shape("text", { class: "tick", x: EDGE.left - 6, y: y(value) + 4, "text-anchor": "end" }, tickText(value)));
  }
  for (const hour of ticks(first, last, 8)) svg.append(shape("text", { class: "tick", x: x(hour), y: height - 5, "text-anchor": "middle" }, `${tickText(hour)} h`));
  if (kind.goal !== null) svg.append(shape("line", { class: "goal", x1: EDGE.left, x2: width - EDGE.right, y1: y(kind.goal), y2: y(kind.goal) }));
  drawLine(svg, pieces(thinned(rows), view.interval_s, (row) => (kind.of(row) === null ? null : [x(row[TIME] / 3600), y(kind.of(row))])));
}

// Times during which one lamp shone: light is what shone before a photograph was taken.
function bands(rows) {
  const found = [];
  for (let i = 1; i < rows.length; i++) {
    const light = rows[i][LIGHT], from = rows[i - 1][TIME] / 3600, to = rows[i][TIME] / 3600;
    const before = found.at(-1);
    if (before && before[0] === light) before[2] = to;
    else found.push([light, from, to]);
  }
  return found.filter(([light]) => light !== "dark");
}

function pointAt(at, svgs, rows, kinds, first, last, told) {
  if (!rows.length) return;
  const { left, width } = at.svg.getBoundingClientRect();
  const hour = first + ((at.x - left - EDGE.left) / (width - EDGE.left - EDGE.right)) * (last - first);
  let low = 0, high = rows.length - 1;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (rows[middle][TIME] / 3600 < hour) low = middle + 1;
    else high = middle;
  }
  const row = rows[low];
  const values = kinds.map((kind) => (kind.of(row) === null ? `${kind.name} –` : `${kind.name} ${kind.of(row).toFixed(1)} ${kind.unit}`));
  told.textContent = `hour ${(row[TIME] / 3600).toFixed(2)}, ${row[LIGHT]}: ${values.join(", ")}`;
  for (const one of svgs) {
    one.querySelector(".cursor")?.remove();
    const size = one.getBoundingClientRect();
    const x = across(size.width, first, last)(row[TIME] / 3600);
    one.append(shape("line", { class: "cursor", x1: x, x2: x, y1: EDGE.top, y2: size.height - EDGE.bottom }));
  }
}

// Not Math.min(...values): thousands of arguments are too many for some browsers.
const least = (values) => values.reduce((a, b) => Math.min(a, b), Infinity);
const most = (values) => values.reduce((a, b) => Math.max(a, b), -Infinity);
