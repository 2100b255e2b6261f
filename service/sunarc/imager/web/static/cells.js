// Maps over the image in cells: light where a value is small, dark where it is large (reversed on dark ground). The classes are
// logarithmic, from the smallest value of the map up to its largest: a map has all shades, whatever the camera.
import { element, label, node, path, telling } from "./draw.js";
import { compass } from "./sky.js";

const SHADES = 6;
const WIDEST = 1e3; // between the largest value and the first class

// A value rounded up to three digits.
function roundedUp(value) {
  const digit = 10 ** (Math.floor(Math.log10(value)) - 2);
  return Number((Math.ceil(value / digit - 1e-9) * digit).toPrecision(3));
}

// The upper ends of the classes, of two digits; the last holds the largest value.
function classEnds(rows) {
  const [least, , most] = span(rows);
  if (!(most > 0)) return [0];
  const from = Math.max(least, most / WIDEST);
  const ends = Array.from({ length: SHADES }, (_, k) => Number((from * (most / from) ** ((k + 1) / SHADES)).toPrecision(2)));
  const distinct = ends.filter((end, k) => k === 0 || end > ends[k - 1]);
  return [...distinct.slice(0, -1), roundedUp(most)];
}

// The smallest, the middle and the largest of the values of a map.
export function span(rows) {
  const values = rows.flat().filter((value) => value !== null).sort((a, b) => a - b);
  return [values[0], values[Math.floor(values.length / 2)], values.at(-1)];
}

export function drawCells(plot, scale, { x_px, y_px, rows }, overlay, [width, height]) {
  plot.setAttribute("viewBox", `-0.5 -0.5 ${width} ${height}`);
  const step = x_px[1] - x_px[0];
  const ends = classEnds(rows);
  const cells = ends.map(() => "");
  const shade = (value) => { const k = ends.findIndex((end) => value <= end); return k < 0 ? ends.length - 1 : k; };
  rows.forEach((row, n) => row.forEach((value, m) => {
    if (value !== null) cells[shade(value)] += `M${x_px[m] - step / 2} ${y_px[n] - step / 2}h${step}v${step}h${-step}z`;
  }));
  const parts = cells.map((d, k) => element("path", { class: `shade-${k}`, d })).filter((_, k) => cells[k]);
  for (const circle of overlay?.zenith_circles ?? []) parts.push(element("path", { class: "over", d: path(circle.pixels) }));
  for (const way of overlay?.sun_paths ?? []) if (way.name === "today") parts.push(element("path", { class: "over sun-way", d: path(way.pixels) }));
  compass(overlay).forEach(([name, at]) => parts.push(label(at, name, width * 0.035, "corner")));
  plot.replaceChildren(...parts);
  scale.replaceChildren(...cells.map((_, k) => {
    const item = node("span", `≤ ${telling(ends[k])}°`);
    const key = element("svg", { viewBox: "0 0 10 10", "aria-hidden": "true" });
    key.append(element("rect", { class: `shade-${k}`, width: 10, height: 10 }));
    item.prepend(key);
    return item;
  }));
}
