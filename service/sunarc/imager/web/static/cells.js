// Maps over the image in cells. The steps are of a scale that stays the same, 1-2-5 degrees: a shade means the same angle in
// every map, every camera and every year, light where it is small, dark where it is large (reversed on dark ground).
import { element, label, node, path, telling } from "./draw.js";
import { compass } from "./sky.js";

const STEPS_DEG = [0.002, 0.005, 0.01, 0.02, 0.05];
const SHADES = STEPS_DEG.length + 1;

const shade = (value) => { const k = STEPS_DEG.findIndex((step) => value <= step); return k < 0 ? SHADES - 1 : k; };

// The smallest, the middle and the largest of the values of a map.
export function span(rows) {
  const values = rows.flat().filter((value) => value !== null).sort((a, b) => a - b);
  return [values[0], values[Math.floor(values.length / 2)], values.at(-1)];
}

export function drawCells(plot, scale, { x_px, y_px, rows }, overlay, [width, height]) {
  plot.setAttribute("viewBox", `-0.5 -0.5 ${width} ${height}`);
  const step = x_px[1] - x_px[0];
  const cells = Array.from({ length: SHADES }, () => "");
  rows.forEach((row, n) => row.forEach((value, m) => {
    if (value !== null) cells[shade(value)] += `M${x_px[m] - step / 2} ${y_px[n] - step / 2}h${step}v${step}h${-step}z`;
  }));
  const parts = cells.map((d, k) => element("path", { class: `shade-${k}`, d })).filter((_, k) => cells[k]);
  for (const circle of overlay?.zenith_circles ?? []) parts.push(element("path", { class: "over", d: path(circle.pixels) }));
  for (const way of overlay?.sun_paths ?? []) if (way.name === "today") parts.push(element("path", { class: "over sun-way", d: path(way.pixels) }));
  compass(overlay).forEach(([name, at]) => parts.push(label(at, name, width * 0.035, "corner")));
  plot.replaceChildren(...parts);
  scale.replaceChildren(...cells.map((_, k) => {
    const item = node("span", k < STEPS_DEG.length ? `≤ ${telling(STEPS_DEG[k])}°` : `> ${telling(STEPS_DEG.at(-1))}°`);
    const key = element("svg", { viewBox: "0 0 10 10", "aria-hidden": "true" });
    key.append(element("rect", { class: `shade-${k}`, width: 10, height: 10 }));
    item.prepend(key);
    return item;
  }));
}
