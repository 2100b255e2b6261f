// The map of 1-sigma: cells over the image, light where it is small, dark where it is large (reversed on dark ground).
import { $, element, label, node, path, telling } from "./draw.js";
import { compass } from "./sky.js";

const SHADES = 6;

export function drawSigma(map, overlay, size) {
  $("sigma").toggleAttribute("hidden", !map);
  if (!map) {
    $("sigma-sum").textContent = "No calibration yet.";
    $("sigma-scale").replaceChildren();
    return;
  }
  const values = map.sigma_deg.flat().filter((value) => value !== null).sort((a, b) => a - b);
  const at = (share) => values[Math.min(values.length - 1, Math.floor(share * values.length))];
  const edges = [...Array(SHADES + 1).keys()].map((k) => (k === SHADES ? values.at(-1) : at(k / SHADES)));
  const shade = (value) => { const k = edges.findIndex((edge, n) => n > 0 && value <= edge); return (k < 1 ? SHADES : k) - 1; };
  $("sigma-sum").textContent = `1-sigma per axis of view directions, degrees: ${telling(values[0])} at best, median ${telling(at(0.5))}, ${telling(values.at(-1))} at worst.`;
  draw(map, overlay, size ?? [1, 1], shade);
  $("sigma-scale").replaceChildren(...[...Array(SHADES).keys()].map((k) => {
    const item = node("span", `≤ ${telling(edges[k + 1])}°`);
    const key = element("svg", { viewBox: "0 0 10 10", "aria-hidden": "true" });
    key.append(element("rect", { class: `shade-${k}`, width: 10, height: 10 }));
    item.prepend(key);
    return item;
  }));
}

function draw(map, overlay, [width, height], shade) {
  const plot = $("sigma");
  plot.setAttribute("viewBox", `-0.5 -0.5 ${width} ${height}`);
  const step = map.x_px[1] - map.x_px[0];
  const cells = Array.from({ length: SHADES }, () => "");
  map.sigma_deg.forEach((row, n) => row.forEach((value, m) => {
    if (value !== null) cells[shade(value)] += `M${map.x_px[m] - step / 2} ${map.y_px[n] - step / 2}h${step}v${step}h${-step}z`;
  }));
  const parts = cells.map((d, k) => element("path", { class: `shade-${k}`, d }));
  for (const circle of overlay?.zenith_circles ?? []) parts.push(element("path", { class: "over", d: path(circle.pixels) }));
  for (const way of overlay?.sun_paths ?? []) if (way.name === "today") parts.push(element("path", { class: "over sun-way", d: path(way.pixels) }));
  compass(overlay).forEach(([name, at]) => parts.push(label(at, name, width * 0.035, "corner")));
  plot.replaceChildren(...parts);
}
